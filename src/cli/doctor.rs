//! `shaketable doctor`: what real time needs of this machine, what is missing, and how to get it.

use super::{CliError, Outcome};
use crate::control::thread::{Awake, PRIORITY, may_use_fifo};
use std::fs;
use std::path::{Path, PathBuf};

/// Check what real-time operation needs on this machine.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder in which runs will be recorded.
    #[arg(long, default_value = "runs")]
    out: PathBuf,
    /// Fail (exit code 1) when something that real time needs is missing.
    #[arg(long)]
    strict: bool,
    /// Print one JSON object on standard output.
    #[arg(long)]
    json: bool,
}

/// How a check turned out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
enum State {
    Ok,
    /// Works, with less certainty.
    Warn,
    /// Real time cannot be had.
    Missing,
    /// Not on this machine, and not needed without hardware.
    Absent,
}

/// One check: what, how it is, and how to fix it.
#[derive(Debug, serde::Serialize)]
struct Check {
    name: &'static str,
    state: State,
    found: String,
    #[serde(skip_serializing_if = "String::is_empty")]
    fix: String,
}

impl Check {
    fn new(name: &'static str, state: State, found: impl Into<String>, fix: impl Into<String>) -> Self {
        let fix = if state == State::Ok { String::new() } else { fix.into() };
        Self { name, state, found: found.into(), fix }
    }
}

/// Runs the subcommand.
///
/// # Errors
/// With `--strict`, when something is missing.
pub fn execute(args: Args) -> Result<Outcome, CliError> {
    let checks = [
        priority(),
        memory(),
        idle_states(),
        preemption(Path::new("/sys/kernel/realtime"), Path::new("/proc/version")),
        governor(Path::new("/sys/devices/system/cpu")),
        throttling(Path::new("/proc/sys/kernel/sched_rt_runtime_us")),
        clock(Path::new("/sys/devices/system/clocksource/clocksource0/current_clocksource")),
        serial(Path::new("/sys/bus/usb-serial/devices")),
        can(Path::new("/sys/class/net")),
        disk(&args.out),
    ];
    let missing = checks.iter().filter(|check| check.state == State::Missing).count();
    if args.json {
        println!("{}", serde_json::json!({ "ready": missing == 0, "checks": checks }));
    } else {
        for check in &checks {
            let mark = match check.state {
                State::Ok => "ok",
                State::Warn => "warn",
                State::Missing => "MISSING",
                State::Absent => "-",
            };
            println!("{mark:<8} {:<22} {}", check.name, check.found);
            if !check.fix.is_empty() {
                println!("{:<8} {:<22} fix: {}", "", "", check.fix);
            }
        }
    }
    if args.strict && missing > 0 {
        return Err(CliError::failed(format!("{missing} things that real time needs are missing")));
    }
    Ok(Outcome::Done)
}

fn read(path: &Path) -> Option<String> {
    fs::read_to_string(path).ok().map(|text| text.trim().to_owned())
}

fn entries(path: &Path) -> Vec<PathBuf> {
    let Ok(found) = fs::read_dir(path) else { return Vec::new() };
    let mut paths: Vec<_> = found.flatten().map(|entry| entry.path()).collect();
    paths.sort();
    paths
}

fn file_name(path: &Path) -> String {
    path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}

fn priority() -> Check {
    match may_use_fifo() {
        Ok(()) => Check::new("real-time priority", State::Ok, format!("SCHED_FIFO {PRIORITY} granted"), ""),
        Err(error) => Check::new(
            "real-time priority",
            State::Missing,
            format!("SCHED_FIFO {PRIORITY} refused: {error}"),
            "`@realtime - rtprio 95` in /etc/security/limits.d/realtime.conf, your user in that group, new login",
        ),
    }
}

fn memory() -> Check {
    let limit = rustix::process::getrlimit(rustix::process::Resource::Memlock).current;
    let root = rustix::process::geteuid().is_root();
    let found = match (root, limit) {
        (true, _) => "unlimited (root)".to_owned(),
        (false, None) => "unlimited".to_owned(),
        (false, Some(bytes)) => format!("{} kB", bytes / 1024),
    };
    // Code, stacks and rings need some 60 MB.
    let enough = root || limit.is_none_or(|bytes| bytes >= 256 << 20);
    let state = if enough { State::Ok } else { State::Missing };
    Check::new(
        "locked memory",
        state,
        found,
        "`@realtime - memlock unlimited` in /etc/security/limits.d/realtime.conf",
    )
}

fn idle_states() -> Check {
    match Awake::request() {
        Ok(_) => Check::new("idle states", State::Ok, "held off during a run", ""),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            Check::new("idle states", State::Absent, "the kernel has no PM QoS interface", "")
        }
        Err(error) => Check::new(
            "idle states",
            State::Missing,
            format!("{}: {error}", Awake::PATH),
            r#"`KERNEL=="cpu_dma_latency", GROUP="realtime", MODE="0660"` in /etc/udev/rules.d/99-realtime.rules"#,
        ),
    }
}

fn preemption(flag: &Path, version: &Path) -> Check {
    let version = read(version).unwrap_or_default();
    if read(flag).as_deref() == Some("1") || version.contains("PREEMPT_RT") {
        return Check::new("kernel preemption", State::Ok, "PREEMPT_RT", "");
    }
    let kind = if version.contains("PREEMPT_DYNAMIC") { "PREEMPT_DYNAMIC" } else { "no PREEMPT_RT" };
    Check::new(
        "kernel preemption",
        State::Warn,
        kind,
        "install a PREEMPT_RT kernel (Debian: linux-image-rt-amd64)",
    )
}

fn governor(cpus: &Path) -> Check {
    let governors: Vec<String> =
        entries(cpus).iter().filter_map(|cpu| read(&cpu.join("cpufreq/scaling_governor"))).collect();
    if governors.is_empty() {
        return Check::new("CPU governor", State::Absent, "no frequency scaling visible", "");
    }
    match governors.iter().find(|governor| *governor != "performance") {
        None => Check::new("CPU governor", State::Ok, "performance", ""),
        Some(other) => {
            Check::new("CPU governor", State::Warn, other.as_str(), "cpupower frequency-set -g performance")
        }
    }
}

fn throttling(path: &Path) -> Check {
    match read(path).as_deref() {
        Some("-1") => Check::new("real-time throttling", State::Ok, "off", ""),
        Some(value) => Check::new(
            "real-time throttling",
            State::Ok,
            format!("{value} us a second for real-time threads; the control step uses under 1 %"),
            "",
        ),
        None => Check::new("real-time throttling", State::Absent, "not visible", ""),
    }
}

fn clock(path: &Path) -> Check {
    match read(path) {
        Some(source) if ["tsc", "kvm-clock", "arch_sys_counter"].contains(&source.as_str()) => {
            Check::new("clock source", State::Ok, source, "")
        }
        Some(source) => Check::new(
            "clock source",
            State::Warn,
            format!("{source}: reading the time takes a system call"),
            "boot with clocksource=tsc if the CPU's is stable",
        ),
        None => Check::new("clock source", State::Absent, "not visible", ""),
    }
}

fn serial(devices: &Path) -> Check {
    let slow: Vec<String> = entries(devices)
        .iter()
        .filter(|device| read(&device.join("latency_timer")).is_some_and(|ms| ms != "1"))
        .map(|device| file_name(device))
        .collect();
    let all = entries(devices).len();
    if all == 0 {
        return Check::new("serial adapters", State::Absent, "no USB serial adapter", "");
    }
    if slow.is_empty() {
        return Check::new("serial adapters", State::Ok, format!("{all}, low latency"), "");
    }
    Check::new(
        "serial adapters",
        State::Missing,
        format!("{} hold data back for up to 16 ms (33 samples)", slow.join(", ")),
        format!("echo 1 > {}/{}/latency_timer, or setserial low_latency", devices.display(), slow[0]),
    )
}

/// `ARPHRD_CAN` of the kernel's `if_arp.h`.
const CAN_LINK_TYPE: &str = "280";

fn can(links: &Path) -> Check {
    let found: Vec<(String, String)> = entries(links)
        .iter()
        .filter(|link| read(&link.join("type")).as_deref() == Some(CAN_LINK_TYPE))
        .map(|link| (file_name(link), read(&link.join("operstate")).unwrap_or_default()))
        .collect();
    let Some((name, _)) = found.first() else {
        return Check::new("CAN interface", State::Absent, "none", "");
    };
    let text = found.iter().map(|(name, state)| format!("{name} {state}")).collect::<Vec<_>>().join(", ");
    // Virtual interfaces call themselves unknown while they are up.
    let up = found.iter().any(|(_, state)| state != "down");
    let state = if up { State::Ok } else { State::Missing };
    Check::new("CAN interface", state, text, format!("ip link set {name} up type can bitrate 1000000"))
}

fn disk(out: &Path) -> Check {
    let there = out.ancestors().find(|path| path.exists()).unwrap_or(Path::new("."));
    let there = if there.as_os_str().is_empty() { Path::new(".") } else { there };
    match rustix::fs::statvfs(there) {
        Ok(space) => {
            let free = space.f_bavail * space.f_frsize;
            // A full sweep takes 125 MB.
            let state = if free > 1 << 30 { State::Ok } else { State::Missing };
            let found = format!("{:.1} GB free, {} full sweeps", free as f64 / 1e9, free / 125_000_000);
            Check::new("disk space", state, found, "make room, or record elsewhere with --out")
        }
        Err(error) => Check::new("disk space", State::Missing, error.to_string(), "--out must be on a disk"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_check_reads_what_the_system_says() {
        let root = tempfile::tempdir().expect("folder");
        let put = |path: &str, text: &str| {
            let path = root.path().join(path);
            fs::create_dir_all(path.parent().expect("parent")).expect("made");
            fs::write(&path, text).expect("written");
            path
        };
        let flag = put("realtime", "1\n");
        let version = put("version", "Linux 6.1 SMP PREEMPT_DYNAMIC");
        assert_eq!(preemption(&flag, &version).state, State::Ok);
        assert_eq!(preemption(&root.path().join("nowhere"), &version).state, State::Warn);
        put("cpu/cpu0/cpufreq/scaling_governor", "performance");
        assert_eq!(governor(&root.path().join("cpu")).state, State::Ok);
        put("cpu/cpu1/cpufreq/scaling_governor", "powersave");
        assert_eq!(governor(&root.path().join("cpu")).found, "powersave");
        put("usb/ttyUSB0/latency_timer", "16");
        let slow = serial(&root.path().join("usb"));
        assert_eq!(slow.state, State::Missing);
        assert!(slow.fix.contains("ttyUSB0/latency_timer"), "{}", slow.fix);
        put("usb/ttyUSB0/latency_timer", "1");
        assert_eq!(serial(&root.path().join("usb")).state, State::Ok);
        put("net/can0/type", "280");
        put("net/can0/operstate", "down");
        put("net/eth0/type", "1");
        assert_eq!(can(&root.path().join("net")).state, State::Missing);
        put("net/can0/operstate", "up");
        assert_eq!(can(&root.path().join("net")).found, "can0 up");
        assert_eq!(can(&root.path().join("usb")).state, State::Absent);
        assert_eq!(clock(&put("clock", "hpet")).state, State::Warn);
        assert_ne!(disk(&root.path().join("runs/deep")).found, "");
    }
}
