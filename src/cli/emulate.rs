//! `shaketable emulate`: the devices of a rig file in software, on a pseudo terminal and a CAN interface, with the simulated
//! table of the same file behind them, in real time. Faults come from `--fault` or from standard input, and so does the word
//! that ends it.

use super::reading::read_model;
use super::{CliError, Outcome};
use crate::config::builtin::find;
use crate::config::{Case, ConfigError};
use crate::control::setup::{Setup, model_of_case};
use crate::rig::RigSpec;
use crate::rig::hardware::{SimulatedPlant, lab_settings};
use crate::sweep::SweepSpec;
use firmware_bridge::drive::CanBus;
use firmware_bridge::emulator::{Fault, Lab};
use std::io::BufRead;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

/// Emulate the devices of a rig: DAQ on a pseudo terminal, drive on a CAN interface.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Rig with a [hardware] part, by name or file.
    #[arg(long, default_value = "lab")]
    rig: String,
    /// Case of the paper whose specimen stands on the table.
    #[arg(long, default_value = "B1-G2-0.05")]
    case: Case,
    /// Specimen, by name or file, in place of the case's.
    #[arg(long)]
    specimen: Option<String>,
    /// Seed of the sensors' noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// A fault and when, in seconds after the drive is first enabled, as in "12.5 daq unplug"; may be repeated.
    /// The same words without a time, a line each on standard input, act at once; `end` there ends the emulation once the
    /// drive rests.
    #[arg(long, value_parser = parse_scheduled)]
    fault: Vec<(f64, Fault)>,
    /// End after so many seconds; without it the devices stay until `end` is said or they are killed.
    #[arg(long)]
    duration: Option<f64>,
    /// Print one JSON object at the end.
    #[arg(long)]
    json: bool,
}

fn parse_scheduled(text: &str) -> Result<(f64, Fault), String> {
    let wrong =
        || format!("`{text}` does not begin with a time in seconds from 0, as in \"12.5 daq unplug\"");
    let (time, words) = text.trim().split_once(' ').ok_or_else(wrong)?;
    let time_s: f64 = time.parse().map_err(|_| wrong())?;
    if !(0.0..=1e6).contains(&time_s) {
        return Err(wrong());
    }
    let fault = words.parse::<Fault>().map_err(|error| error.to_string())?;
    Ok((time_s, fault))
}

/// Runs the subcommand.
///
/// # Errors
/// Bad configuration, no CAN interface, no pseudo terminal.
pub fn execute(args: Args) -> Result<Outcome, CliError> {
    let usage = |error: ConfigError| CliError::Usage(error.into());
    let rig: RigSpec = find("rigs", &args.rig).and_then(|source| source.parse()).map_err(usage)?;
    let Some(hardware) = rig.hardware.clone() else {
        return Err(CliError::usage(format!("{} has no [hardware] part that could be emulated", args.rig)));
    };
    let specimen = match &args.specimen {
        Some(name) => read_model(name)?,
        None => model_of_case(&args.case),
    };
    let setup = Setup {
        rig,
        sweep: SweepSpec::paper(),
        model: specimen.clone(),
        specimen,
        case: None,
        safety: None,
        seed: args.seed,
        name: "emulate".into(),
    };
    let plant = SimulatedPlant::new(setup.simulated_rig().map_err(CliError::usage)?);
    let mut settings = lab_settings(&hardware, setup.rig.sample_rate_hz, args.seed);
    settings.port_link = Some(PathBuf::from(&hardware.daq.port));
    settings.schedule = args.fault;
    let bus = CanBus::open(&hardware.drive.interface).map_err(CliError::failed)?;
    let lab = Lab::start(settings, bus, Box::new(plant)).map_err(CliError::failed)?;
    eprintln!(
        "emulating: DAQ on {} ({}), drive on {} as node {}",
        hardware.daq.port,
        lab.port_path(),
        hardware.drive.interface,
        hardware.drive.node
    );
    stay(&lab, &read_lines(), args.duration)?;
    if args.json {
        print_json(&lab);
    }
    Ok(Outcome::Done)
}

/// Lines of standard input as they come; the channel ends with the input.
fn read_lines() -> Receiver<String> {
    let (tell, lines) = channel();
    // The thread ends with the input or with the process; nobody waits for it.
    std::thread::spawn(move || {
        for line in std::io::stdin().lock().lines().map_while(Result::ok) {
            if tell.send(line).is_err() {
                return;
            }
        }
    });
    lines
}

fn stay(lab: &Lab, lines: &Receiver<String>, duration_s: Option<f64>) -> Result<(), CliError> {
    let seconds = duration_s.unwrap_or(f64::from(u32::MAX));
    let length = Duration::try_from_secs_f64(seconds)
        .map_err(|_| CliError::usage(format!("--duration {seconds} s; allowed: 0 s and more")))?;
    let end = Instant::now() + length;
    loop {
        let left = end.saturating_duration_since(Instant::now());
        match lines.recv_timeout(left) {
            Ok(line) if line.trim().is_empty() => {}
            Ok(line) if line.trim() == "end" => {
                come_to_rest(lab, end);
                return Ok(());
            }
            Ok(line) => match line.parse::<Fault>() {
                Ok(fault) => lab.inject(fault),
                Err(error) => eprintln!("{error}"),
            },
            Err(RecvTimeoutError::Timeout) => return Ok(()),
            // Input has ended; the devices stay.
            Err(RecvTimeoutError::Disconnected) => {
                std::thread::sleep(end.saturating_duration_since(Instant::now()));
                return Ok(());
            }
        }
    }
}

/// Waits until all is heard that was sent so far and the drive rests, at most until `end`.
fn come_to_rest(lab: &Lab, end: Instant) {
    let heard = lab.report().looks + 2;
    while Instant::now() < end {
        let report = lab.report();
        if report.looks >= heard && report.at_rest() {
            return;
        }
        // A report is made every millisecond or two.
        std::thread::sleep(Duration::from_millis(1));
    }
}

fn print_json(lab: &Lab) {
    let report = lab.report();
    let object = serde_json::json!({
        "samples": report.samples,
        "late_steps": report.late_steps,
        "drive": format!("{:?}", report.drive),
        "stopped_itself_after_s": report.stopped_itself_after_s,
        "fault_at_sequence": report.fault_at_sequence,
        "out_of_operation_after_fault_s": report.out_of_operation_after_fault_s,
        "displacement_m": report.demand.displacement_m,
        "velocity_m_s": report.demand.velocity_m_s,
    });
    println!("{object}");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scheduled_faults_are_read_or_refused() {
        assert_eq!(parse_scheduled("12.5 daq unplug"), Ok((12.5, Fault::DaqUnplug)));
        for wrong in ["daq unplug", "-1 daq unplug", "1 daq explode", "x", ""] {
            assert!(parse_scheduled(wrong).is_err(), "{wrong}");
        }
    }
}
