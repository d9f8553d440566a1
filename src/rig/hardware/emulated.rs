//! The simulated rig as the mechanics behind emulated devices, and the devices that a `[hardware]` part describes: used by
//! `shaketable emulate` and by the tests.

use super::HardwareSpec;
use crate::control::thread::prioritise_link;
use crate::rig::Rig;
use crate::rig::simulated::SimulatedRig;
use crate::stream::{Command, Sample};
use firmware_bridge::emulator::{DaqNode, Demand, DriveSpec, LabSettings, Plant};

/// The simulated rig behind emulated devices.
pub struct SimulatedPlant {
    rig: SimulatedRig,
    last: [f64; 5],
}

impl SimulatedPlant {
    /// Takes a rig at rest.
    pub fn new(rig: SimulatedRig) -> Self {
        Self { rig, last: [0.0; 5] }
    }
}

impl Plant for SimulatedPlant {
    fn step(&mut self, demand: Demand) -> [f64; 5] {
        let command = Command {
            displacement_m: demand.displacement_m,
            velocity_m_s: demand.velocity_m_s,
            acceleration_m_s2: demand.acceleration_m_s2,
        };
        // A fault of the simulated drive shows in the motion; the emulated drive has its own.
        let _ = self.rig.write(&command);
        self.rig.advance();
        while let Ok(Some(Sample { channels: c, .. })) = self.rig.read() {
            self.last = [
                c.table_displacement_m,
                c.table_acceleration_m_s2,
                c.mass_acceleration_1_m_s2,
                c.mass_acceleration_2_m_s2,
                c.relative_displacement_m,
            ];
        }
        self.last
    }
}

/// Emulated devices that answer to what a rig file expects.
pub fn lab_settings(spec: &HardwareSpec, rate_hz: f64, seed: u64) -> LabSettings {
    let (daq, drive) = (&spec.daq, &spec.drive);
    let serial = daq.serial.as_deref().unwrap_or("EMULATED-1");
    LabSettings {
        rate_hz,
        port_link: None,
        drive: DriveSpec {
            node: drive.node,
            identity: [drive.vendor.unwrap_or(0), drive.product.unwrap_or(0), 1, drive.serial.unwrap_or(1)],
            name: "emulated CiA 402 servo drive".into(),
            units: drive.units(),
        },
        daq: DaqNode::new(daq.vendor.unwrap_or(0), daq.product.unwrap_or(0), serial, rate_hz, seed),
        schedule: Vec::new(),
        on_thread: Some(prioritise_link),
    }
}
