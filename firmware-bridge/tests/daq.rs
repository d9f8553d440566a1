//! The DAQ link against the emulated device, in real time over a pseudo terminal.

mod support;

use firmware_bridge::clock::HostClock;
use firmware_bridge::daq::{DaqDevice, DaqError, DaqFault, DaqSample, DaqStream, LowLatency};
use firmware_bridge::emulator::{Fault, Lab};
use support::{daq_settings, lab, stream, until};

fn collect(stream: &mut DaqStream, samples: &mut Vec<DaqSample>) {
    while let Some(sample) = stream.pop() {
        samples.push(sample);
    }
}

/// Samples until `done`, at most 5 s.
fn samples_until(
    stream: &mut DaqStream,
    mut done: impl FnMut(&DaqStream, &[DaqSample]) -> bool,
) -> Vec<DaqSample> {
    let mut samples = Vec::new();
    until("the samples are there", || {
        collect(stream, &mut samples);
        done(stream, &samples)
    });
    collect(stream, &mut samples);
    samples
}

fn assert_contiguous(samples: &[DaqSample]) {
    for (n, sample) in samples.iter().enumerate() {
        assert_eq!(sample.sequence, n as u64);
    }
}

fn start() -> (Lab, DaqStream) {
    let (lab, _bus) = lab(vec![]);
    let stream = stream(&lab, HostClock::new());
    (lab, stream)
}

#[test]
fn samples_flow_in_order_with_their_values_and_a_fitted_clock() {
    let (lab, _bus) = lab(vec![]);
    let device = DaqDevice::open(daq_settings(lab.port_path())).expect("a device");
    assert_eq!(device.low_latency, LowLatency::NotNeeded);
    assert_eq!(device.rate_hz, 2048.0);
    let mut stream = device.start(HostClock::new(), None).expect("samples");
    let samples = samples_until(&mut stream, |_, samples| samples.len() > 6000);
    assert_contiguous(&samples);
    let counters = stream.counters();
    assert_eq!((counters.lost, counters.bad_frames, counters.repeated), (0, 0, 0));
    for (value, expected) in samples[100].values.iter().zip([0.0, 0.0, 0.5, -0.5, 0.001]) {
        assert!((value - expected).abs() < 5e-6, "{value} for {expected}");
    }
    // Both ends run on the same clock here.
    assert!(counters.clock.drift_ppm.abs() < 200.0, "{:?}", counters.clock);
}

#[test]
fn garbage_costs_at_most_the_frame_that_it_hits() {
    let (lab, mut stream) = start();
    samples_until(&mut stream, |_, samples| samples.len() > 200);
    let before = stream.counters();
    lab.inject(Fault::DaqGarbage(500));
    samples_until(&mut stream, |stream, _| stream.counters().bad_frames > 0);
    samples_until(&mut stream, |_, samples| samples.len() > 500);
    let after = stream.counters();
    assert!(after.lost - before.lost <= 2, "{after:?}");
    assert_eq!(stream.fault(), None);
}

#[test]
fn bit_errors_are_detected_and_every_lost_sample_is_counted() {
    let (lab, mut stream) = start();
    lab.inject(Fault::DaqBitErrors(1e-4));
    let samples = samples_until(&mut stream, |_, samples| samples.len() > 6000);
    let counters = stream.counters();
    let last = samples.last().expect("samples").sequence;
    // What is missing by the numbers is what was counted; later samples may have come since.
    let missing = last + 1 - samples.len() as u64;
    assert!(missing > 60 && missing <= counters.lost, "{missing} {counters:?}");
    for sample in &samples {
        assert!((sample.values[2] - 0.5).abs() < 5e-6, "a spoilt sample got through");
    }
    assert_eq!(stream.fault(), None);
}

#[test]
fn a_burst_of_33_late_samples_is_accepted_whole() {
    let (lab, mut stream) = start();
    samples_until(&mut stream, |_, samples| samples.len() > 1500);
    lab.inject(Fault::DaqHold(33));
    let mut stream_end = 0;
    samples_until(&mut stream, |stream, _| {
        stream_end = stream.counters().samples;
        stream.counters().largest_burst >= 33
    });
    let counters = stream.counters();
    assert_eq!((counters.lost, counters.ring_overflow), (0, 0));
    assert!(counters.late > 0 && counters.worst_late_us > 10_000, "{counters:?}");
    assert_eq!(stream.fault(), None);
}

#[test]
fn a_cable_pulled_out_ends_the_stream_with_all_samples_before_it() {
    let (lab, mut stream) = start();
    let mut samples = samples_until(&mut stream, |_, samples| samples.len() > 1000);
    lab.inject(Fault::DaqUnplug);
    samples.extend(samples_until(&mut stream, |stream, _| stream.fault().is_some()));
    assert_eq!(samples.len() as u64, stream.counters().samples);
    assert_contiguous(&samples);
    let fault = stream.fault().expect("a fault");
    assert!(fault.to_string().contains("DAQ cable"), "{fault}");
    drop(stream);
    // Between runs the device may be opened again, which says what is wrong until the cable is back.
    assert!(matches!(
        DaqDevice::open(daq_settings(lab.port_path())),
        Err(DaqError::Open { .. } | DaqError::Line { .. } | DaqError::NoAnswer { .. })
    ));
}

#[test]
fn silence_is_a_fault_within_its_time() {
    let (lab, mut stream) = start();
    samples_until(&mut stream, |_, samples| samples.len() > 200);
    lab.inject(Fault::DaqSilent);
    samples_until(&mut stream, |stream, _| stream.fault().is_some());
    assert_eq!(stream.fault(), Some(DaqFault::Silent));
}

#[test]
fn the_wrong_device_is_refused_by_name_and_number() {
    let (lab, _bus) = lab(vec![]);
    let mut settings = daq_settings(lab.port_path());
    settings.expected.serial = Some("KR-0002".into());
    let error = DaqDevice::open(settings).err().expect("refused");
    assert!(error.to_string().contains("serial number is KR-0001, expected KR-0002"), "{error}");
}

#[test]
fn a_rate_that_the_device_has_not_is_refused() {
    let (lab, _bus) = lab(vec![]);
    let mut settings = daq_settings(lab.port_path());
    settings.rate_hz = 4096.0;
    assert!(matches!(DaqDevice::open(settings), Err(DaqError::Refused { value: 2_048_000, .. })));
}

#[test]
fn a_second_run_starts_anew_on_the_same_line() {
    let (lab, mut first) = start();
    samples_until(&mut first, |_, samples| samples.len() > 100);
    drop(first);
    let mut second = stream(&lab, HostClock::new());
    assert_contiguous(&samples_until(&mut second, |_, samples| samples.len() > 100));
}
