//! The onboard model as it is compared with measurements: driven by the motion of the table as its accelerometer and its displacement
//! tell it together, and the specimen seen through the instruments that its model has, so that a model with a `laser-gain` predicts what
//! the laser says. The control step lets it follow every sample.

use crate::model::{Observer, Response, Specimen};
use crate::rig::RigSpec;
use crate::signal::{TableMotion, TableNoise};
use crate::stream::Sample;

/// The onboard model with what drives it.
pub struct Onboard {
    model: Box<dyn Specimen>,
    table: TableMotion,
}

impl Onboard {
    /// A model made for one step a sample period of the rig, on a table at rest.
    pub fn new(model: Box<dyn Specimen>, rig: &RigSpec) -> Self {
        let noise = TableNoise {
            displacement_m: rig.sensors.table_displacement_noise_m,
            acceleration_m_s2: rig.sensors.accelerometer_noise_m_s2,
        };
        Self { model, table: TableMotion::new(rig.sample_rate_hz, noise) }
    }

    /// The response to the next sample.
    pub fn follow(&mut self, sample: &Sample) -> Response {
        let c = &sample.channels;
        let table = self.table.process(sample.sequence, c.table_displacement_m, c.table_acceleration_m_s2);
        self.model.step(table)
    }
}

/// A specimen whose response is what the instruments of its model say.
pub(super) struct Observed {
    specimen: Box<dyn Specimen>,
    observer: Observer,
}

impl Observed {
    pub(super) fn new(specimen: Box<dyn Specimen>, observer: Observer) -> Self {
        Self { specimen, observer }
    }

    fn look(&mut self, response: Response) -> Response {
        let seen = self.observer.observe(&response);
        Response {
            relative_displacement_m: seen.relative_displacement_m,
            mass_acceleration_m_s2: 0.5 * (seen.mass_acceleration_1_m_s2 + seen.mass_acceleration_2_m_s2),
            ..response
        }
    }
}

impl Specimen for Observed {
    fn reset(&mut self) {
        self.specimen.reset();
        self.observer.reset();
    }

    fn step(&mut self, table_acceleration_m_s2: f64) -> Response {
        let response = self.specimen.step(table_acceleration_m_s2);
        self.look(response)
    }

    fn impose(&mut self, relative_displacement_m: f64, relative_velocity_m_s: f64) -> Response {
        let response = self.specimen.impose(relative_displacement_m, relative_velocity_m_s);
        self.look(response)
    }

    fn prime(&mut self, table_acceleration_m_s2: f64) {
        self.specimen.prime(table_acceleration_m_s2);
    }

    fn set_time_s(&mut self, time_s: f64) {
        self.specimen.set_time_s(time_s);
    }
}
