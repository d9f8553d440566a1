//! Stretches of many samples: steps as long as the error control lets them be, samples off their dense output.

use super::super::Response;
use super::dynamics::{Course, Drive, Motion, Sine};
use super::specimen::General;
use super::{StretchVisit, Sweepable};

impl<const N: usize> General<N> {
    /// [`Specimen::run`] of a system that is `PLAIN` or not.
    pub(super) fn run_of<const PLAIN: bool>(&mut self, drive: Course<'_>, visit: &mut dyn FnMut(&Response)) {
        let dt = self.system.sample_period_s;
        let (count, mut next) = (drive.samples.len(), 0);
        let duration = count as f64 * dt;
        self.advance(duration, drive, Motion::Free, &mut |solver, begin, end, step| {
            let (mode, layout) = (&solver.mode, &solver.layout);
            // Rounding must not lose the last sample.
            while next < count && ((next + 1) as f64 * dt <= end || end == duration) {
                let time = ((next + 1) as f64 * dt).min(end);
                let part = if end > begin { (time - begin) / (end - begin) } else { 1.0 };
                let (y, at) = (step.at(part), (solver.time_s + time, drive.samples[next]));
                let forces = solver.system.rates_of::<N, PLAIN>(at, &y, mode, layout, None).1;
                visit(&solver.response_of(&y, &forces));
                next += 1;
            }
        });
        // Where the motion ran away, or the last step ended a rounding before its time.
        if next < count {
            let forces = self.now(duration, drive, Motion::Free).forces;
            (next..count).for_each(|_| visit(&self.response(&forces)));
        }
    }

    /// [`Sweepable::stretch`] of a system that is `PLAIN` or not.
    fn stretch_of<const PLAIN: bool>(&mut self, duration: f64, drive: Sine, visit: &mut StretchVisit<'_>) {
        self.advance(duration, drive, Motion::Free, &mut |solver, begin, end, step| {
            let (mode, layout) = (&solver.mode, &solver.layout);
            let state = |part: f64, table: f64| {
                let (y, time_s) = (step.at(part), solver.time_s + begin + part * (end - begin));
                let forces = solver.system.rates_of::<N, PLAIN>((time_s, table), &y, mode, layout, None).1;
                solver.response_of(&y, &forces)
            };
            visit(begin, end, mode.contact, &state);
        });
    }
}

impl<const N: usize> Sweepable for General<N> {
    fn stretch(&mut self, duration: f64, drive: Sine, visit: &mut StretchVisit<'_>) {
        if self.system.is_plain() {
            self.stretch_of::<true>(duration, drive, visit);
        } else {
            self.stretch_of::<false>(duration, drive, visit);
        }
        self.table = Some(drive.at(duration));
    }
}
