//! The checks before a run, in the order in which they are made: sweep against the table, disk, real-time
//! set-up, then the rig itself: links, zeros and noise at rest, a small sine around the loop. The desk makes
//! them on a worker thread; the operator confirms what they show.

use crate::control::clock::VirtualClock;
use crate::control::setup::{Setup, SetupError};
use crate::control::thread::{may_use_fifo, prioritise_link};
use crate::rig::hardware::{HardwareRig, Preflight, PreflightSpec, check_loop};
use serde::Serialize;
use std::path::Path;
use utoipa::ToSchema;

/// Rows of a run take so much disk, bytes.
const ROW_BYTES: f64 = 112.0;

/// One check.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct Line {
    /// What was checked.
    pub name: &'static str,
    /// It passed.
    pub ok: bool,
    /// It must pass before the bench can be armed.
    pub required: bool,
    /// What was found.
    pub found: String,
}

/// One channel at rest.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct ChannelAtRest {
    /// Its name.
    pub channel: String,
    /// Mean at rest, SI.
    pub zero: f64,
    /// Standard deviation at rest, SI.
    pub noise: f64,
    /// What it shows over what the others make one expect.
    pub gain: f64,
    /// Unit of zero and noise.
    pub unit: &'static str,
}

/// Everything that was found.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct Checked {
    /// Number to confirm with.
    pub id: u64,
    /// When, UTC.
    pub at_utc: String,
    /// The checks.
    pub lines: Vec<Line>,
    /// Zeros and noise.
    pub channels: Vec<ChannelAtRest>,
    /// Delay from command to measured table motion, s.
    pub chain_delay_s: Option<f64>,
    /// Measured over commanded table displacement.
    pub table_gain: Option<f64>,
    /// Steps, and how long the sweep takes, s.
    pub steps: usize,
    /// Duration from rest to rest, s.
    pub duration_s: f64,
    /// All required checks passed.
    pub passed: bool,
}

/// Makes the checks.
pub fn check(setup: &Setup, out: &Path, require_realtime: bool, id: u64) -> Checked {
    let mut checked = Checked {
        id,
        at_utc: crate::record::folder::now_utc(),
        lines: Vec::new(),
        channels: Vec::new(),
        chain_delay_s: None,
        table_gain: None,
        steps: 0,
        duration_s: 0.0,
        passed: false,
    };
    let mut line = |name, required, result: Result<String, String>| {
        let ok = result.is_ok();
        let found = result.unwrap_or_else(|reason| reason);
        checked.lines.push(Line { name, ok, required, found });
    };
    let schedule = setup.schedule();
    line("sweep within the table's limits", true, sweep(setup));
    let duration_s = schedule.as_ref().map_or(0.0, |schedule| schedule.duration_s());
    line("disk", true, disk(out, duration_s * setup.rig.sample_rate_hz * ROW_BYTES));
    let real_time = may_use_fifo()
        .map(|()| "SCHED_FIFO granted to the control thread".to_owned())
        .map_err(|error| format!("degraded: SCHED_FIFO refused ({error}); see `shaketable doctor`"));
    line("real time", require_realtime, real_time);
    let looped = rig(setup);
    let links = match &setup.rig.hardware {
        Some(_) => looped.as_ref().map(|p| format!("drive {}, DAQ {}", p.drive, p.daq)).map_err(Clone::clone),
        None => Ok("simulated rig: no cables".to_owned()),
    };
    line("links", true, links);
    let sound = looped.as_ref().map_err(Clone::clone).map(|p| {
        format!(
            "signs and gains sound, chain delay {:.2} ms, table gain {:.4}",
            1e3 * p.chain_delay_s,
            p.table_gain
        )
    });
    line("loop check", true, sound);
    if let Ok(found) = looped {
        line("zeros", false, zeros(setup, &found));
        checked.chain_delay_s = Some(found.chain_delay_s);
        checked.table_gain = Some(found.table_gain);
        checked.channels = found.channels.iter().map(channel).collect();
    }
    checked.steps = schedule.as_ref().map_or(0, |schedule| schedule.steps().len());
    checked.duration_s = duration_s;
    checked.passed = checked.lines.iter().all(|line| line.ok || !line.required);
    checked
}

fn channel(found: &crate::rig::hardware::ChannelCheck) -> ChannelAtRest {
    ChannelAtRest {
        channel: found.channel.to_owned(),
        zero: found.zero,
        noise: found.noise,
        gain: found.gain,
        unit: if found.channel.contains("acceleration") { "m/s2" } else { "m" },
    }
}

fn sweep(setup: &Setup) -> Result<String, String> {
    let refused = |error: SetupError| error.to_string();
    let preview = setup.preview().map_err(refused)?;
    preview.check().map_err(|error| error.to_string())?;
    let used = super::preview::uses(&preview);
    let worst = used.iter().max_by(|a, b| a.used.total_cmp(&b.used));
    Ok(worst.map_or_else(String::new, |w| {
        format!("most used: {} at {:.0} % of the limit", w.quantity, 100.0 * w.used)
    }))
}

fn disk(out: &Path, needed_bytes: f64) -> Result<String, String> {
    let space = rustix::fs::statvfs(out).map_err(|error| format!("{}: {error}", out.display()))?;
    let free = space.f_bavail as f64 * space.f_frsize as f64;
    let text = format!("{:.1} GB free, {:.2} GB needed", free / 1e9, needed_bytes / 1e9);
    if free > 2.0 * needed_bytes + 1e8 { Ok(text) } else { Err(text) }
}

/// Zeros beyond what the instruments are trusted with are shown, not refused: the operator confirms them.
fn zeros(setup: &Setup, found: &Preflight) -> Result<String, String> {
    let trusted = &setup.rig.tolerances;
    let beyond: Vec<String> = found
        .channels
        .iter()
        .filter(|c| match c.channel {
            "relative displacement" => c.zero.abs() > trusted.laser_zero_m,
            "table displacement" => false,
            _ => c.zero.abs() > trusted.accelerometer_zero_m_s2,
        })
        .map(|c| format!("{} {:.2e}", c.channel, c.zero))
        .collect();
    if beyond.is_empty() {
        Ok("within the instruments' tolerances".to_owned())
    } else {
        Err(beyond.join(", "))
    }
}

/// The rig at rest and around the loop; real devices in real time, the simulated rig in virtual time.
fn rig(setup: &Setup) -> Result<Preflight, String> {
    if let Some(devices) = &setup.rig.hardware {
        // The links run as they will in the run, so that the checks pass or fail as its start will.
        let opened = HardwareRig::open(devices, setup.rig.sample_rate_hz, Some(prioritise_link));
        return opened.map(|(_, found)| found).map_err(|error| error.to_string());
    }
    let mut rig = setup.simulated_rig().map_err(|error| error.to_string())?;
    check_loop(&mut rig, &mut VirtualClock, &PreflightSpec::default(), setup.rig.sample_rate_hz)
        .map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::setup::model_of_case;
    use crate::rig::RigSpec;
    use crate::sweep::SweepSpec;

    fn setup() -> Setup {
        let model = model_of_case(&"B1-G2-0.05".parse().expect("case"));
        Setup {
            rig: RigSpec::default(),
            sweep: SweepSpec::paper(),
            specimen: model.clone(),
            model,
            case: None,
            safety: None,
            seed: 3,
            name: "check".into(),
        }
    }

    #[test]
    fn a_sound_rig_passes_and_shows_its_noise() {
        let out = tempfile::tempdir().expect("folder");
        let found = check(&setup(), out.path(), false, 1);
        assert!(found.passed, "{:#?}", found.lines);
        let laser = found.channels.iter().find(|c| c.channel == "relative displacement").expect("laser");
        assert!((1e-5..6e-5).contains(&laser.noise), "{laser:?}");
        assert!(found.chain_delay_s.is_some_and(|d| (1e-4..0.03).contains(&d)), "{found:?}");
    }

    #[test]
    fn a_wrong_gain_and_a_sweep_beyond_the_table_are_refused() {
        let out = tempfile::tempdir().expect("folder");
        let mut wrong = setup();
        wrong.rig.sensors.laser_gain = -1.0;
        wrong.sweep.acceleration_g = 1.5;
        let found = check(&wrong, out.path(), false, 1);
        let failed: Vec<_> = found.lines.iter().filter(|l| !l.ok && l.required).map(|l| l.name).collect();
        assert!(!found.passed);
        assert_eq!(failed, ["sweep within the table's limits", "loop check"], "{:#?}", found.lines);
    }
}
