//! The table itself: a servo drive with cascaded position and velocity loops, force lag, friction,
//! force and motion limits, and the platen on which the specimen pushes back.

use super::spec::TableSpec;
use crate::stream::Command;

/// Commands that can wait for the drive; one more than the longest delay allowed.
const DELAY_LINE: usize = 65;

/// State and loops of the table; one call of [`Actuator::substep`] a fraction of a sample period.
pub(super) struct Actuator {
    spec: TableSpec,
    substep_s: f64,
    lag: f64,
    velocity_gain_n_s_m: f64,
    period: u64,
    waiting: [(u64, Command); DELAY_LINE],
    written: usize,
    taken: usize,
    active: Command,
    since_active_s: f64,
    since_command_s: f64,
    force_n: f64,
    mean_square_n2: f64,
    folded: bool,
    drive: Drive,
    /// Displacement, m.
    pub(super) displacement_m: f64,
    /// Velocity, m/s.
    pub(super) velocity_m_s: f64,
    /// Acceleration, m/s2.
    pub(super) acceleration_m_s2: f64,
}

/// What the drive is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Drive {
    /// Follows commands.
    Enabled,
    /// Decelerates by itself and then holds.
    QuickStop,
    /// Tripped: decelerates by itself and then holds, takes no commands.
    Tripped,
}

impl Actuator {
    pub(super) fn new(spec: &TableSpec, sample_rate_hz: f64) -> Self {
        let substep_s = 1.0 / (sample_rate_hz * f64::from(spec.substeps.max(1)));
        Self {
            spec: spec.clone(),
            substep_s,
            lag: 1.0 - (-substep_s / spec.force_lag_s).exp(),
            velocity_gain_n_s_m: spec.platen_mass_kg * std::f64::consts::TAU * spec.velocity_loop_hz,
            period: 0,
            waiting: [(0, Command::default()); DELAY_LINE],
            written: 0,
            taken: 0,
            active: Command::default(),
            since_active_s: 0.0,
            since_command_s: 0.0,
            force_n: 0.0,
            mean_square_n2: 0.0,
            folded: false,
            drive: Drive::Enabled,
            displacement_m: 0.0,
            velocity_m_s: 0.0,
            acceleration_m_s2: 0.0,
        }
    }

    /// What the drive is doing.
    pub(super) fn drive(&self) -> Drive {
        self.drive
    }

    /// Whether the continuous-force limit holds the force down.
    pub(super) fn folded(&self) -> bool {
        self.folded
    }

    /// Takes the command of this period; it acts `command_delay_samples` periods from now.
    pub(super) fn command(&mut self, command: &Command) {
        let due = self.period + u64::from(self.spec.command_delay_samples);
        if self.written - self.taken < DELAY_LINE {
            self.waiting[self.written % DELAY_LINE] = (due, *command);
            self.written += 1;
        }
        self.since_command_s = 0.0;
    }

    /// The drive stops by itself; a trip keeps it from ever following commands again.
    pub(super) fn stop(&mut self, tripped: bool) {
        if tripped {
            self.drive = Drive::Tripped;
        } else if self.drive == Drive::Enabled {
            self.drive = Drive::QuickStop;
        }
    }

    /// Opens a sample period: the command that is due now acts; without one, the last extrapolates.
    pub(super) fn begin_period(&mut self) {
        while self.taken < self.written && self.waiting[self.taken % DELAY_LINE].0 <= self.period {
            // A drive that stops by itself hears no commands.
            if self.drive == Drive::Enabled {
                self.active = self.waiting[self.taken % DELAY_LINE].1;
                self.since_active_s = 0.0;
            }
            self.taken += 1;
        }
        self.period += 1;
        if self.written > 0 && self.since_command_s > self.spec.command_timeout_s {
            self.stop(false);
        }
    }

    /// Set-point at this instant: between two commands the drive extrapolates the last one.
    fn reference(&self) -> (f64, f64, f64) {
        let now = self.active.after(self.since_active_s);
        (now.displacement_m, now.velocity_m_s, now.acceleration_m_s2)
    }

    /// The stop that the drive makes by itself: constant deceleration, then position hold.
    fn stop_reference(&mut self) -> (f64, f64, f64) {
        let (position, velocity, _) = self.reference();
        let deceleration = self.spec.quick_stop_deceleration_m_s2;
        let slower = (velocity.abs() - deceleration * self.substep_s).max(0.0).copysign(velocity);
        let acceleration = (slower - velocity) / self.substep_s;
        self.active = Command { displacement_m: position, velocity_m_s: slower, acceleration_m_s2: 0.0 };
        self.since_active_s = 0.0;
        (position, slower, acceleration)
    }

    /// Advances one integration step against the reaction of the specimen (N, on the table), and
    /// returns the table acceleration at its end, m/s2.
    ///
    /// Cascade as in industrial servo drives: `F = Kv (Kp (x_ref - x) + v_ff - v) + m a_ff`.
    pub(super) fn substep(&mut self, reaction_n: f64) -> f64 {
        let step = self.substep_s;
        let (position, velocity, acceleration) = match self.drive {
            Drive::Enabled => self.reference(),
            Drive::QuickStop | Drive::Tripped => self.stop_reference(),
        };
        let half_stroke = 0.5 * self.spec.stroke_m;
        if position.abs() > half_stroke || self.displacement_m.abs() > half_stroke {
            self.stop(true);
        }
        let limit = self.spec.velocity_limit_m_s;
        let wanted_velocity = (self.spec.position_gain_1_s
            * (position.clamp(-half_stroke, half_stroke) - self.displacement_m)
            + self.spec.velocity_feedforward * velocity)
            .clamp(-limit, limit);
        let mass = self.spec.platen_mass_kg;
        let wanted_force = self.velocity_gain_n_s_m * (wanted_velocity - self.velocity_m_s)
            + self.spec.acceleration_feedforward * mass * acceleration;
        let bound = self.force_bound_n();
        self.force_n += self.lag * (wanted_force.clamp(-bound, bound) - self.force_n);
        self.watch_foldback();
        // Coulomb friction, rounded off within 0.5 mm/s so that the explicit step stays stable.
        let friction = self.spec.friction_n * (self.velocity_m_s / 5e-4).clamp(-1.0, 1.0);
        let before = self.acceleration_m_s2;
        let after = ((self.force_n - friction + reaction_n) / mass)
            .clamp(-self.spec.acceleration_limit_m_s2, self.spec.acceleration_limit_m_s2);
        self.displacement_m += step * (self.velocity_m_s + step * (2.0 * before + after) / 6.0);
        self.velocity_m_s += 0.5 * step * (before + after);
        self.acceleration_m_s2 = after;
        self.since_active_s += step;
        self.since_command_s += step;
        after
    }

    fn force_bound_n(&self) -> f64 {
        match &self.spec.foldback {
            Some(fold) if self.folded => fold.folded_force_n,
            _ => self.spec.peak_force_n,
        }
    }

    fn watch_foldback(&mut self) {
        let Some(fold) = &self.spec.foldback else { return };
        let share = self.substep_s / fold.time_constant_s;
        self.mean_square_n2 += share * (self.force_n * self.force_n - self.mean_square_n2);
        let limit = fold.limit_n_rms * fold.limit_n_rms;
        if self.mean_square_n2 > limit {
            self.folded = true;
        } else if self.mean_square_n2 < limit * fold.recovery * fold.recovery {
            self.folded = false;
        }
    }
}
