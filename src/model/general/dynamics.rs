//! Rates of all states within one mode, and the forces that go with them.

use super::super::Regime;
use super::super::elementary::sin_cos;
use super::super::system::{Point, System};
use super::events::root;

/// Table acceleration within one stretch of time.
pub trait Drive: Copy {
    /// m/s2, at a time since the beginning of the stretch, s.
    fn at(&self, time_s: f64) -> f64;
}

/// First-order hold.
#[derive(Clone, Copy, Debug)]
pub struct Line {
    /// At the beginning, m/s2.
    pub start: f64,
    /// m/s3.
    pub slope: f64,
}

impl Drive for Line {
    fn at(&self, time_s: f64) -> f64 {
        self.start + self.slope * time_s
    }
}

/// A smooth course through samples: cubics with the slopes of central differences (E. Catmull and R. Rom, in: Computer Aided
/// Geometric Design, 1974, 317).
#[derive(Clone, Copy, Debug)]
pub struct Course<'a> {
    /// At the beginning, m/s2.
    pub start: f64,
    /// One sample period later and so on, m/s2.
    pub samples: &'a [f64],
    /// 1/s.
    pub rate_hz: f64,
}

impl Drive for Course<'_> {
    fn at(&self, time_s: f64) -> f64 {
        let last = self.samples.len();
        let value = |i: usize| if i == 0 { self.start } else { self.samples[i.min(last) - 1] };
        let x = time_s * self.rate_hz;
        let i = (x.max(0.0) as usize).min(last.max(1) - 1);
        let (part, from, to) = (x - i as f64, value(i), value(i + 1));
        // At the ends the slope is that of the line.
        let before = if i == 0 { 2.0 * from - to } else { value(i - 1) };
        let after = if i + 1 >= last { 2.0 * to - from } else { value(i + 2) };
        let (rise, out) = (0.5 * (to - before), 0.5 * (after - from));
        let way = to - from;
        from + part * (rise + part * (3.0 * way - 2.0 * rise - out + part * (rise + out - 2.0 * way)))
    }
}

/// One step of an ideal sweep, from phase 0.
#[derive(Clone, Copy, Debug)]
pub struct Sine {
    /// m/s2.
    pub amplitude: f64,
    /// rad/s.
    pub angular_frequency: f64,
}

impl Drive for Sine {
    fn at(&self, time_s: f64) -> f64 {
        self.amplitude * sin_cos(self.angular_frequency * time_s).0
    }
}

/// Who moves the mass.
#[derive(Clone, Copy, Debug)]
pub enum Motion {
    /// The forces.
    Free,
    /// An imposed acceleration, value and slope.
    Imposed(Line),
}

/// State of the joint in series with the isolator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Joint {
    /// No joint: the isolator follows the mass.
    Rigid,
    /// Within the play.
    Open,
    /// Against the stop that pushes the isolator to positive (1) or negative (-1) displacement.
    Closed(i8),
}

/// What the bearings do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sliding {
    /// No dry friction.
    Smooth,
    /// Sliding with this sign of the velocity.
    Slip(i8),
    /// Held.
    Stick,
}

/// A free tip: its deformation at a time since reset.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tip {
    /// m.
    pub deformation_m: f64,
    /// s.
    pub since_s: f64,
}

/// The piece of the model that is active.
#[derive(Clone, Copy, Debug)]
pub struct Mode {
    /// Segment of the isolator.
    pub segment: i32,
    /// Right and left bumper in contact.
    pub contact: [bool; 2],
    /// Free tips.
    pub tips: [Tip; 2],
    /// Bearings.
    pub sliding: Sliding,
    /// Joint.
    pub joint: Joint,
    /// Direction of the isolator's motion, for terms with reversals; 0 when none has them.
    pub direction: i8,
}

impl Mode {
    /// As responses state it.
    pub fn regime(&self) -> Regime {
        Regime {
            isolator_branch: self.segment.unsigned_abs().min(255) as u8,
            right_contact: self.contact[0],
            left_contact: self.contact[1],
            sticking: self.sliding == Sliding::Stick,
        }
    }
}

/// Share of what holds an isolator behind an open joint that its terms may leave of it where it relaxes by its dashpot alone.
const SLACK: f64 = 1e-9;

/// Forces at one instant.
#[derive(Clone, Copy, Debug, Default)]
pub struct Forces {
    /// All forces on the mass that oppose positive displacement, friction among them, N.
    pub restoring_n: f64,
    /// The same without friction, N.
    pub without_friction_n: f64,
    /// Contact forces right and left, N.
    pub contact_n: [f64; 2],
    /// Force of isolator and joint, N.
    pub element_n: f64,
    /// Relative acceleration of the mass, m/s2.
    pub acceleration_m_s2: f64,
    /// Rate of the isolator's displacement, m/s.
    pub element_velocity_m_s: f64,
}

/// Where states beside displacement and velocity begin.
#[derive(Clone, Copy, Debug)]
pub struct Layout {
    /// First of the four of the stands.
    pub stand: usize,
    /// Displacement of the isolator behind the joint.
    pub element: usize,
    /// First of the terms.
    pub terms: usize,
}

impl Layout {
    pub fn of(system: &System) -> Self {
        let element = 2 + if system.stand.is_some() { 4 } else { 0 };
        Self { stand: 2, element, terms: element + usize::from(system.joint_half_width_m.is_some()) }
    }
}

impl System {
    /// Neither stands nor joint nor loss of stiffness.
    #[inline]
    pub(super) fn is_plain(&self) -> bool {
        self.stand.is_none() && self.joint_half_width_m.is_none() && self.degradation.is_none()
    }

    /// Displacement and velocity of the mass towards one side's bumper, and the rate of its base.
    #[inline]
    pub(super) fn approach<const N: usize>(&self, side: usize, y: &[f64; N], layout: &Layout) -> (f64, f64) {
        self.approach_of::<N, false>(side, y, layout)
    }

    #[inline]
    fn approach_of<const N: usize, const PLAIN: bool>(
        &self,
        side: usize,
        y: &[f64; N],
        layout: &Layout,
    ) -> (f64, f64) {
        let (sign, gap) = if side == 0 { (1.0, self.gap_right_m) } else { (-1.0, self.gap_left_m) };
        let (base, rate) = if !PLAIN && self.stand.is_some() {
            (y[layout.stand + 2 * side], y[layout.stand + 2 * side + 1])
        } else {
            (0.0, 0.0)
        };
        (sign * (y[0] - base) - gap, sign * (y[1] - rate))
    }

    /// Rates of all states and the forces, at `time` s since reset under the table acceleration.
    #[inline]
    pub(super) fn rates<const N: usize>(
        &self,
        at: (f64, f64),
        y: &[f64; N],
        mode: &Mode,
        layout: &Layout,
        motion: Option<f64>,
    ) -> ([f64; N], Forces) {
        if self.is_plain() {
            self.rates_of::<N, true>(at, y, mode, layout, motion)
        } else {
            self.rates_of::<N, false>(at, y, mode, layout, motion)
        }
    }

    /// [`System::rates`]; for a `PLAIN` system the compiler leaves out stands, joint and loss of stiffness, and
    /// where it stands in line also what is not asked for, which samples of a sweep gain a third by.
    #[inline(always)]
    pub(super) fn rates_of<const N: usize, const PLAIN: bool>(
        &self,
        (time_s, table): (f64, f64),
        y: &[f64; N],
        mode: &Mode,
        layout: &Layout,
        motion: Option<f64>,
    ) -> ([f64; N], Forces) {
        let mut dy = [0.0; N];
        let mut forces = Forces::default();
        let mut penetrations = [0.0; 2];
        if self.has_bumper {
            for (side, penetration) in penetrations.iter_mut().enumerate() {
                let (p, rate) = self.approach_of::<N, PLAIN>(side, y, layout);
                *penetration = p.max(0.0);
                if mode.contact[side] {
                    forces.contact_n[side] = self.bumper.force_n(p, rate);
                }
            }
        }
        let mut point = Point {
            time_s,
            displacement_m: y[0],
            velocity_m_s: y[1],
            table_acceleration_m_s2: table,
            penetration_right_m: penetrations[0],
            penetration_left_m: penetrations[1],
        };
        let mut at = layout.terms;
        let mut rest = self.constant_n + forces.contact_n[0] - forces.contact_n[1];
        for term in &self.mass_terms {
            let end = at + term.states();
            rest += term.force(&point, &y[at..end], &mut dy[at..end]);
            at = end;
        }
        let held = mode.sliding == Sliding::Stick && motion.is_none();
        let jointed = !PLAIN && mode.joint != Joint::Rigid;
        if jointed {
            point.displacement_m = y[layout.element];
        }
        if held {
            point.velocity_m_s = 0.0;
        }
        let (slope, intercept) = self.line(mode.segment);
        let degradation = if PLAIN { None } else { self.degradation };
        let factor = degradation.map_or(1.0, |d| 1.0 - d.delta * (1.0 - (-d.rate * time_s).exp()));
        let elastic = factor * (slope * point.displacement_m + intercept);
        let open = jointed && mode.joint == Joint::Open;
        if open {
            self.relax_element(elastic, &mut point, y, at, &mut dy);
        } else {
            forces.element_n = elastic + self.damping_n_s_m * point.velocity_m_s;
        }
        for term in &self.isolator_terms {
            let end = at + term.states();
            let force = term.force(&point, &y[at..end], &mut dy[at..end]);
            at = end;
            if !open {
                forces.element_n += force;
            }
        }
        if jointed {
            dy[layout.element] = point.velocity_m_s;
        }
        forces.element_velocity_m_s = point.velocity_m_s;
        self.finish::<N, PLAIN>(table, y, mode, layout, motion, rest + forces.element_n, dy, forces)
    }

    /// Behind an open joint the isolator carries no force: it relaxes against its own dashpot, and against whatever of its terms depends
    /// on its velocity. Without that a joint that opens under such a term would close again at once, and so on.
    fn relax_element<const N: usize>(
        &self,
        elastic: f64,
        point: &mut Point,
        y: &[f64; N],
        first: usize,
        dy: &mut [f64; N],
    ) {
        point.velocity_m_s = 0.0;
        if self.damping_n_s_m == 0.0 {
            return;
        }
        let mut moving = *point;
        let mut force = |velocity_m_s: f64| {
            moving.velocity_m_s = velocity_m_s;
            let (mut force, mut at) = (elastic + self.damping_n_s_m * velocity_m_s, first);
            for term in &self.isolator_terms {
                let end = at + term.states();
                force += term.force(&moving, &y[at..end], &mut dy[at..end]);
                at = end;
            }
            force
        };
        let held = force(0.0);
        let by_dashpot = -held / self.damping_n_s_m;
        let left = if self.isolator_terms.is_empty() { 0.0 } else { held.signum() * force(by_dashpot) };
        point.velocity_m_s = if left < -SLACK * held.abs() {
            root((0.0, held.abs()), (by_dashpot, left), |velocity_m_s| held.signum() * force(velocity_m_s))
        } else {
            by_dashpot
        };
    }

    #[allow(clippy::too_many_arguments)]
    #[inline(always)]
    fn finish<const N: usize, const PLAIN: bool>(
        &self,
        table: f64,
        y: &[f64; N],
        mode: &Mode,
        layout: &Layout,
        motion: Option<f64>,
        without_friction: f64,
        mut dy: [f64; N],
        mut forces: Forces,
    ) -> ([f64; N], Forces) {
        let reaction = self.table_inverse_mass_1_kg * (forces.contact_n[0] - forces.contact_n[1]);
        forces.without_friction_n = without_friction;
        let friction = match mode.sliding {
            Sliding::Smooth => 0.0,
            Sliding::Slip(sign) => f64::from(sign) * self.friction.map_or(0.0, |friction| friction.at(y[1])),
            Sliding::Stick if motion.is_some() => 0.0,
            Sliding::Stick => -self.mass_kg * (table + reaction) - without_friction,
        };
        forces.restoring_n = without_friction + friction;
        dy[0] = y[1];
        dy[1] = motion.unwrap_or(-forces.restoring_n / self.mass_kg - table - reaction);
        if motion.is_none() && mode.sliding == Sliding::Stick {
            (dy[0], dy[1]) = (0.0, 0.0);
        }
        forces.acceleration_m_s2 = dy[1];
        if let (Some(stand), false) = (&self.stand, PLAIN) {
            for side in 0..2 {
                let i = layout.stand + 2 * side;
                let push = if side == 0 { forces.contact_n[0] } else { -forces.contact_n[1] };
                let own = stand.stiffness_n_m * y[i] + stand.damping_n_s_m * y[i + 1];
                dy[i] = y[i + 1];
                dy[i + 1] = (push - own) / stand.mass_kg - table - reaction;
            }
        }
        (dy, forces)
    }
}
