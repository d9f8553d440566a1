//! The onboard model as it is compared with measurements: the specimen seen through the instruments that
//! its model has, so that a model with a `laser-gain` predicts what the laser says.

use crate::model::{Observer, Response, Specimen};

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
