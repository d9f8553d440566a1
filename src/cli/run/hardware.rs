//! What a run on real devices adds at its end: how the links did goes into the run's manifest, and the operator is told
//! which cable to look at.

use crate::cli::CliError;
use crate::control::session::Finished;
use crate::rig::hardware::HardwareMonitor;

/// Writes down how the links did and tells the operator.
///
/// # Errors
/// The manifest cannot be written.
pub(crate) fn close(links: &HardwareMonitor, mut finished: Finished) -> Result<Finished, CliError> {
    let complaints = links.complaints();
    for line in &complaints {
        eprintln!("{line}");
    }
    let (line, bus) = links.counters();
    eprintln!(
        "DAQ line: {} samples, {} lost, {} bad frames, {} late (worst {:.1} ms), largest burst {}, clock {:+.1} ppm; \
         drive: {} cycles, {} skipped, worst {:.2} ms late, {} without an answer",
        line.samples,
        line.lost,
        line.bad_frames,
        line.late,
        1e-3 * line.worst_late_us as f64,
        line.largest_burst,
        line.clock.drift_ppm,
        bus.cycles,
        bus.skipped,
        1e-6 * bus.worst_late_ns as f64,
        bus.missed_inputs
    );
    finished.manifest.configure("links", text(links, &complaints));
    let (daq, drive) = links.faults();
    if daq.is_some() || drive.is_some() {
        finished.manifest.clean = false;
        finished.manifest.cause.get_or_insert_with(|| complaints.join("; "));
    }
    finished.folder.write_manifest(&finished.manifest).map_err(CliError::failed)?;
    Ok(finished)
}

/// The counters as TOML.
fn text(links: &HardwareMonitor, complaints: &[String]) -> String {
    let (line, bus) = links.counters();
    let mut text = String::new();
    let counters = [
        ("daq_samples", line.samples),
        ("daq_lost", line.lost),
        ("daq_gaps", line.gaps),
        ("daq_bad_frames", line.bad_frames),
        ("daq_repeated", line.repeated),
        ("daq_ring_overflow", line.ring_overflow),
        ("daq_late", line.late),
        ("daq_worst_late_us", line.worst_late_us),
        ("daq_largest_burst", line.largest_burst),
        ("drive_cycles", bus.cycles),
        ("drive_skipped", bus.skipped),
        ("drive_worst_late_ns", bus.worst_late_ns),
        ("drive_missed_inputs", bus.missed_inputs),
        ("drive_send_failures", bus.send_failures),
        ("drive_bus_disturbed", bus.disturbed),
        ("drive_commands", bus.commands),
    ];
    for (name, value) in counters {
        text += &format!("{name} = {value}\n");
    }
    text += &format!("daq_clock_offset_ns = {:.0}\n", line.clock.offset_ns);
    text += &format!("daq_clock_drift_ppm = {:.3}\n", line.clock.drift_ppm);
    text += &format!("complaints = {}\n", toml::Value::from(complaints.to_vec()));
    text
}
