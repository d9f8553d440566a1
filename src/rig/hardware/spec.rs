//! The `[hardware]` part of a rig file: which devices, how they are wired, and what must stop the drive when
//! the host dies.

use crate::config::Check;
use firmware_bridge::canopen::objects::{Address, at};
use firmware_bridge::daq::{DaqSettings, ExpectedDevice};
use firmware_bridge::drive::{DriveSettings, ExpectedDrive, Setting, Units};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Real devices.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HardwareSpec {
    /// The DAQ device.
    pub daq: DaqSpec,
    /// The drive.
    pub drive: DriveLinkSpec,
    /// The loop check before a run.
    #[serde(default)]
    pub preflight: PreflightSpec,
}

/// The DAQ device and its serial line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DaqSpec {
    /// Serial port.
    pub port: String,
    /// Baud rate, 1/s.
    pub baud: u32,
    /// Vendor number that must answer; absent: any.
    pub vendor: Option<u32>,
    /// Product number that must answer; absent: any.
    pub product: Option<u32>,
    /// Serial number that must answer; absent: any.
    pub serial: Option<String>,
    /// Silence after which the cable counts as broken, ms.
    pub silence_ms: u32,
}

/// The drive and its bus.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DriveLinkSpec {
    /// CAN interface.
    pub interface: String,
    /// Node number of the drive.
    pub node: u8,
    /// Node number of the host's heartbeat.
    pub host_node: u8,
    /// Vendor number that must answer; absent: any.
    pub vendor: Option<u32>,
    /// Product code that must answer; absent: any.
    pub product: Option<u32>,
    /// Serial number that must answer; absent: any.
    pub serial: Option<u32>,
    /// Position counts a metre; negative turns the axis round.
    pub counts_per_m: f64,
    /// Units of velocity a metre a second, same sign.
    pub velocity_per_m_s: f64,
    /// Torque feed-forward, per mille of the rated torque a m/s2; 0 for none.
    pub torque_per_m_s2: f64,
    /// Mode of operation.
    pub mode: Mode,
    /// Period of SYNC, us.
    pub cycle_us: u32,
    /// Without the host's heartbeat for so long the drive stops by itself, ms.
    pub host_lost_ms: u32,
    /// Without process data or SYNC for so long the drive stops by itself, ms.
    pub commands_lost_ms: u32,
    /// The vendor's object with the SYNC time-out in ms, where there is one.
    pub sync_timeout_object: Option<ObjectAddress>,
    /// Period of the drive's heartbeat, ms.
    pub heartbeat_ms: u32,
    /// Cycles without process data after which the drive counts as silent.
    pub missed_cycles: u32,
    /// Without a fresh command of the control thread for so long the link asks for quick stop, ms.
    pub command_stale_ms: u32,
    /// Deceleration of quick stop, m/s2.
    pub quick_stop_m_s2: f64,
    /// Following error at which the drive trips, m.
    pub following_error_m: f64,
    /// Speed above which a command counts as a jump, m/s.
    pub speed_limit_m_s: f64,
    /// Further objects of this make of drive, written in order and read back.
    #[serde(default)]
    pub settings: Vec<ObjectSpec>,
}

/// Mode of operation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mode {
    /// Cyclic synchronous position (8).
    CyclicSynchronousPosition,
    /// Interpolated position (7).
    InterpolatedPosition,
}

/// An object's address.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectAddress {
    /// Index.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
}

/// An object and its value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectSpec {
    /// Index.
    pub index: u16,
    /// Sub-index.
    pub sub: u8,
    /// Value.
    pub value: u32,
    /// Length, bytes.
    pub bytes: u8,
}

/// The loop check.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PreflightSpec {
    /// Frequency, Hz: above the resonance of the specimen, so that the mass lags and signs show.
    pub frequency_hz: f64,
    /// Amplitude of the table, m.
    pub amplitude_m: f64,
    /// Cycles that are counted.
    pub cycles: u32,
    /// How far gains may be off, relative.
    pub gain_tolerance: f64,
    /// Longest chain delay, s.
    pub longest_delay_s: f64,
    /// Speed of the way to the centre, m/s.
    pub centre_speed_m_s: f64,
}

impl Default for PreflightSpec {
    fn default() -> Self {
        Self {
            frequency_hz: 2.0,
            amplitude_m: 0.0015,
            cycles: 4,
            gain_tolerance: 0.10,
            longest_delay_s: 0.03,
            centre_speed_m_s: 0.02,
        }
    }
}

impl From<ObjectAddress> for Address {
    fn from(from: ObjectAddress) -> Self {
        at(from.index, from.sub)
    }
}

fn ms(time: u32) -> Duration {
    Duration::from_millis(time.into())
}

impl DaqSpec {
    /// The link's settings.
    pub fn settings(&self, rate_hz: f64) -> DaqSettings {
        DaqSettings {
            path: self.port.clone(),
            baud: self.baud,
            rate_hz,
            expected: ExpectedDevice {
                vendor: self.vendor,
                product: self.product,
                serial: self.serial.clone(),
            },
            silence: ms(self.silence_ms),
        }
    }
}

impl DriveLinkSpec {
    /// The drive's units.
    pub fn units(&self) -> Units {
        Units {
            counts_per_m: self.counts_per_m,
            velocity_per_m_s: self.velocity_per_m_s,
            torque_per_m_s2: self.torque_per_m_s2,
        }
    }

    /// The link's settings.
    pub fn settings(&self) -> DriveSettings {
        let setting =
            |o: &ObjectSpec| Setting { address: at(o.index, o.sub), value: o.value, bytes: o.bytes };
        DriveSettings {
            node: self.node,
            host_node: self.host_node,
            expected: ExpectedDrive { vendor: self.vendor, product: self.product, serial: self.serial },
            units: self.units(),
            cycle: Duration::from_micros(self.cycle_us.into()),
            mode: match self.mode {
                Mode::CyclicSynchronousPosition => 8,
                Mode::InterpolatedPosition => 7,
            },
            host_lost: ms(self.host_lost_ms),
            commands_lost: ms(self.commands_lost_ms),
            sync_timeout: self.sync_timeout_object.map(Into::into),
            drive_heartbeat: ms(self.heartbeat_ms),
            missed_cycles: self.missed_cycles,
            command_stale: ms(self.command_stale_ms),
            quick_stop_m_s2: self.quick_stop_m_s2,
            following_error_m: self.following_error_m,
            speed_limit_m_s: self.speed_limit_m_s,
            settings: self.settings.iter().map(setting).collect(),
        }
    }
}

impl Check for HardwareSpec {
    fn check(&self) -> Result<(), (String, String)> {
        let (q, d, p) = (&self.daq, &self.drive, &self.preflight);
        let f = f64::from;
        let ranges = [
            ("daq.baud", f(q.baud), 115_200.0, 3e6, "baud"),
            // An adapter may hold samples back for 16 ms, which is no silence.
            ("daq.silence_ms", f(q.silence_ms), 25.0, 1000.0, "ms"),
            ("drive.node", f64::from(d.node), 1.0, 127.0, ""),
            ("drive.host_node", f64::from(d.host_node), 1.0, 127.0, ""),
            ("drive.counts_per_m", d.counts_per_m.abs(), 1e3, 1e10, "(absolute)"),
            ("drive.velocity_per_m_s", d.velocity_per_m_s.abs(), 1.0, 1e10, "(absolute)"),
            ("drive.torque_per_m_s2", d.torque_per_m_s2.abs(), 0.0, 1e4, "(absolute)"),
            ("drive.cycle_us", f(d.cycle_us), 500.0, 10_000.0, "us"),
            ("drive.host_lost_ms", f(d.host_lost_ms), 5.0, 50.0, "ms"),
            ("drive.commands_lost_ms", f(d.commands_lost_ms), 5.0, 50.0, "ms"),
            ("drive.heartbeat_ms", f(d.heartbeat_ms), 2.0, 100.0, "ms"),
            ("drive.missed_cycles", f(d.missed_cycles), 2.0, 200.0, "cycles"),
            ("drive.command_stale_ms", f(d.command_stale_ms), 5.0, 200.0, "ms"),
            ("drive.quick_stop_m_s2", d.quick_stop_m_s2, 0.1, 20.0, "m/s2"),
            ("drive.following_error_m", d.following_error_m, 1e-4, 0.1, "m"),
            ("drive.speed_limit_m_s", d.speed_limit_m_s, 0.01, 5.0, "m/s"),
            ("preflight.frequency_hz", p.frequency_hz, 0.5, 5.0, "Hz"),
            ("preflight.amplitude_m", p.amplitude_m, 1e-4, 0.005, "m"),
            ("preflight.cycles", f(p.cycles), 2.0, 20.0, "cycles"),
            ("preflight.gain_tolerance", p.gain_tolerance, 0.01, 0.3, ""),
            ("preflight.longest_delay_s", p.longest_delay_s, 1e-3, 0.1, "s"),
            ("preflight.centre_speed_m_s", p.centre_speed_m_s, 1e-3, 0.1, "m/s"),
        ];
        for (key, value, low, high, unit) in ranges {
            if !(low..=high).contains(&value) {
                return Err((
                    format!("hardware.{key}"),
                    format!("{value} {unit}; allowed: {low} to {high} {unit}"),
                ));
            }
        }
        if d.node == d.host_node {
            let reason = format!("{} is the drive's own number; allowed: another one", d.host_node);
            return Err(("hardware.drive.host_node".into(), reason));
        }
        if d.counts_per_m.signum() != d.velocity_per_m_s.signum() {
            let reason = "its sign differs from that of counts_per_m; allowed: the same".to_owned();
            return Err(("hardware.drive.velocity_per_m_s".into(), reason));
        }
        Ok(())
    }
}
