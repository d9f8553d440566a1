use super::*;
use crate::model::Response;

/// Linear oscillator stepped by its exact transition over a constant acceleration.
struct Oscillator {
    omega: f64,
    zeta: f64,
    step_s: f64,
    d: f64,
    v: f64,
}

impl Specimen for Oscillator {
    fn reset(&mut self) {
        (self.d, self.v) = (0.0, 0.0);
    }

    fn step(&mut self, table_acceleration_m_s2: f64) -> Response {
        let static_m = -table_acceleration_m_s2 / (self.omega * self.omega);
        let (w, s) = (self.omega * (1.0 - self.zeta * self.zeta).sqrt(), self.zeta * self.omega);
        let (a, decay) = (self.d - static_m, (-s * self.step_s).exp());
        let b = (self.v + s * a) / w;
        let (sin, cos) = (w * self.step_s).sin_cos();
        self.d = static_m + decay * (a * cos + b * sin);
        self.v = decay * ((b * w - s * a) * cos - (a * w + s * b) * sin);
        Response {
            relative_displacement_m: self.d,
            relative_velocity_m_s: self.v,
            mass_acceleration_m_s2: -self.omega * self.omega * self.d - 2.0 * s * self.v,
            ..Response::default()
        }
    }

    fn impose(&mut self, d: f64, v: f64) -> Response {
        (self.d, self.v) = (d, v);
        Response { relative_displacement_m: d, relative_velocity_m_s: v, ..Response::default() }
    }
}

const RATE_HZ: f64 = 2048.0;

fn rig(spec: &SimulatedSpec, mass_kg: f64) -> SimulatedRig {
    let specimen =
        Oscillator { omega: 6.3, zeta: 0.17, step_s: specimen_step_s(spec, RATE_HZ), d: 0.0, v: 0.0 };
    SimulatedRig::new(spec, Box::new(specimen), mass_kg, RATE_HZ, 7)
}

/// Sine with its displacement, velocity and acceleration, risen over `rise` periods.
fn sine(amplitude_m: f64, frequency_hz: f64, k: u64) -> Command {
    let w = std::f64::consts::TAU * frequency_hz;
    let t = k as f64 / RATE_HZ;
    let u = (t / 2.0).min(1.0);
    let (s, ds, dds) = (
        u * u * u * (10.0 - 15.0 * u + 6.0 * u * u),
        if u < 1.0 { 30.0 * u * u * (1.0 - u) * (1.0 - u) / 2.0 } else { 0.0 },
        if u < 1.0 { 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / 4.0 } else { 0.0 },
    );
    let (sin, cos) = (w * t).sin_cos();
    Command {
        displacement_m: -amplitude_m * s * sin,
        velocity_m_s: -amplitude_m * (ds * sin + s * w * cos),
        acceleration_m_s2: -amplitude_m * (dds * sin + 2.0 * ds * w * cos - s * w * w * sin),
    }
}

fn run(rig: &mut SimulatedRig, periods: u64, command: impl Fn(u64) -> Command) -> Vec<Sample> {
    let mut samples = Vec::new();
    for k in 0..periods {
        rig.advance();
        while let Ok(Some(sample)) = rig.read() {
            samples.push(sample);
        }
        let _ = rig.write(&command(k));
    }
    samples
}

fn quiet() -> SimulatedSpec {
    let sensors = SensorSpec {
        accelerometer_noise_m_s2: 0.0,
        laser_noise_m: 0.0,
        table_displacement_noise_m: 0.0,
        displacement_bits: 32,
        ..SensorSpec::default()
    };
    SimulatedSpec { sensors, ..SimulatedSpec::default() }
}

#[test]
fn the_table_follows_its_command_within_a_tenth_of_a_millimetre() {
    for (frequency_hz, amplitude_m) in [(0.5, 0.0497), (1.0, 0.0124), (3.0, 0.00138)] {
        let mut rig = rig(&quiet(), 500.0);
        let delay = rig.chain_delay_s();
        let samples = run(&mut rig, 6 * 2048, |k| sine(amplitude_m, frequency_hz, k));
        let worst = samples[3 * 2048..]
            .iter()
            .map(|sample| {
                let reference = sine(amplitude_m, frequency_hz, sample.sequence - 1);
                let late = reference.displacement_m - delay * reference.velocity_m_s;
                (sample.channels.table_displacement_m - late).abs()
            })
            .fold(0.0, f64::max);
        assert!(worst < 1.1e-4, "{frequency_hz} Hz: {worst} m");
    }
}

#[test]
fn the_specimen_pushes_the_table_back() {
    let mut stiff = rig(&quiet(), 0.0);
    let mut loaded = rig(&quiet(), 500.0);
    let command = |k| sine(0.0124, 1.0, k);
    let alone = run(&mut stiff, 8 * 2048, command);
    let coupled = run(&mut loaded, 8 * 2048, command);
    // Reaction M A over the drive's static stiffness Kv Kp of 95 MN/m.
    let (mut difference, mut reaction) = (0.0f64, 0.0f64);
    for (a, b) in alone.iter().zip(&coupled).skip(5 * 2048) {
        difference =
            difference.max((a.channels.table_displacement_m - b.channels.table_displacement_m).abs());
        reaction = reaction.max(500.0 * b.channels.mass_acceleration_m_s2().abs());
    }
    let expected = reaction / 94.7e6;
    assert!((0.7..1.4).contains(&(difference / expected)), "{difference} against {expected} m");
}

#[test]
fn the_same_seed_gives_the_same_samples_and_another_does_not() {
    let spec = SimulatedSpec::default();
    let command = |k| sine(0.005, 2.0, k);
    let first = run(&mut rig(&spec, 500.0), 2048, command);
    assert_eq!(first, run(&mut rig(&spec, 500.0), 2048, command));
    let mut other = rig(&spec, 500.0);
    other.sensors = Sensors::new(&spec.sensors, RATE_HZ, 4, Pcg64Mcg::seed_from_u64(8));
    assert_ne!(first, run(&mut other, 2048, command));
}

#[test]
fn skipped_periods_lose_no_sample_and_the_drive_extrapolates() {
    let mut rig = rig(&quiet(), 500.0);
    let mut sequences = Vec::new();
    let mut worst = 0.0f64;
    let mut k = 0u64;
    while k < 4 * 2048 {
        let periods = if k % 500 == 499 { 20 } else { 1 };
        for _ in 0..periods {
            rig.advance();
            k += 1;
        }
        while let Ok(Some(sample)) = rig.read() {
            sequences.push(sample.sequence);
            let reference = sine(0.0124, 1.0, sample.sequence.saturating_sub(1));
            let late = reference.displacement_m - rig.chain_delay_s() * reference.velocity_m_s;
            worst = worst.max((sample.channels.table_displacement_m - late).abs());
        }
        assert!(rig.write(&sine(0.0124, 1.0, k - 1)).is_ok());
    }
    assert!(sequences.windows(2).all(|pair| pair[1] == pair[0] + 1));
    assert_eq!(sequences.len() as u64, k);
    assert!(worst < 2e-4, "{worst} m");
}

#[test]
fn without_commands_the_drive_stops_by_itself() {
    let spec = quiet();
    let mut rig = rig(&spec, 500.0);
    run(&mut rig, 5 * 2048 / 2, |k| sine(0.0124, 1.0, k));
    let timeout = (spec.table.command_timeout_s * RATE_HZ) as u64;
    let mut last = Sample::default();
    for _ in 0..timeout + 2048 {
        rig.advance();
        while let Ok(Some(sample)) = rig.read() {
            last = sample;
        }
    }
    assert!(!last.status.has(StatusBits::DRIVE_ENABLED));
    let (_, velocity, acceleration) = rig.true_table_motion();
    assert!(velocity.abs() < 1e-4 && acceleration.abs() < 1e-2, "{velocity} m/s, {acceleration} m/s2");
}

#[test]
fn leaving_the_stroke_trips_the_drive() {
    let spec = quiet();
    let mut rig = rig(&spec, 500.0);
    let samples = run(&mut rig, 6 * 2048, |k| sine(0.104, 0.3, k));
    assert!(samples.iter().any(|sample| sample.status.has(StatusBits::DRIVE_FAULT)));
    let reach = samples.iter().map(|s| s.channels.table_displacement_m.abs()).fold(0.0, f64::max);
    assert!(reach < 0.5 * spec.table.stroke_m + 1e-3, "{reach} m");
    assert_eq!(rig.write(&Command::default()), Err(RigFault::DriveTrip));
}

#[test]
fn fold_back_holds_the_force_down_after_a_second_of_overload() {
    let mut spec = quiet();
    spec.table.foldback =
        Some(FoldbackSpec { limit_n_rms: 300.0, folded_force_n: 200.0, ..FoldbackSpec::default() });
    let mut rig = rig(&spec, 500.0);
    run(&mut rig, 4 * 2048, |k| sine(0.0124, 1.0, k));
    assert!(rig.folded());
    let mut free = self::rig(&quiet(), 500.0);
    run(&mut free, 4 * 2048, |k| sine(0.0124, 1.0, k));
    assert!(!free.folded());
}

#[test]
fn every_fault_shows_where_it_should() {
    let spec = quiet();
    let command = |k| sine(0.0124, 1.0, k);
    let with = |fault: Fault, periods: u64| {
        let mut rig = rig(&spec, 500.0);
        run(&mut rig, 3 * 2048, command);
        rig.faults().set(fault, true);
        let samples = run(&mut rig, periods, |k| command(k + 3 * 2048));
        (rig, samples)
    };
    let (_, frozen) = with(Fault::FrozenFeedback, 100);
    assert!(frozen[1..].iter().all(|s| s.channels == frozen[0].channels));
    assert_eq!(frozen.last().map(|s| s.sequence), Some(3 * 2048 + 99));
    assert!(with(Fault::Dropout, 50).1.is_empty());
    let (mut rig, burst) = with(Fault::LateBurst, 32);
    assert!(burst.is_empty());
    assert_eq!(run(&mut rig, 1, |_| Command::default()).len(), 33);
    let (_, repeated) = with(Fault::RepeatedSample, 10);
    assert_eq!(repeated[0].sequence, 3 * 2048 - 1);
    let (_, nan) = with(Fault::NotANumber(Channel::RelativeDisplacement), 3);
    assert!(nan[2].channels.relative_displacement_m.is_nan());
    assert!(nan[2].channels.table_displacement_m.is_finite());
    let (_, stuck) = with(Fault::Stuck(Channel::MassAcceleration2), 9);
    let first = stuck[0].channels;
    assert!(stuck.iter().all(|s| s.channels.mass_acceleration_2_m_s2 == first.mass_acceleration_2_m_s2));
    assert!(stuck.iter().any(|s| s.channels.mass_acceleration_1_m_s2 != first.mass_acceleration_1_m_s2));
    let swap = Fault::Swapped(Channel::TableAcceleration, Channel::MassAcceleration1);
    let (_, swapped) = with(swap, 1);
    let (_, healthy) = with(Fault::Swapped(Channel::TableDisplacement, Channel::TableDisplacement), 1);
    assert_eq!(swapped[0].channels.table_acceleration_m_s2, healthy[0].channels.mass_acceleration_1_m_s2);
    let (mut off, samples) = with(Fault::BusOff, 2048);
    assert_eq!(off.write(&Command::default()), Err(RigFault::DriveLink));
    assert!(samples.last().is_some_and(|s| s.status.has(StatusBits::LINK_DOWN)));
    assert!(!samples.last().is_some_and(|s| s.status.has(StatusBits::DRIVE_ENABLED)));
    let garbage = with(Fault::SerialGarbage, 900).1.len();
    assert!((200..400).contains(&garbage), "{garbage}");
    let (mut tripped, samples) = with(Fault::DriveTrip, 3);
    assert_eq!(tripped.write(&Command::default()), Err(RigFault::DriveTrip));
    assert!(samples[0].status.has(StatusBits::DRIVE_FAULT));
}
