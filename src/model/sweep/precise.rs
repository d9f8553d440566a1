//! The published model in double-double arithmetic (`twofloat`, some 31 digits): power series from sample
//! to sample, corners halved down to 1e-30 s. It shares no line with the solvers; whole sweeps of the
//! paper in closed form are held against it.

use super::plan::Plan;
use super::{StepPeaks, simulate_sweep};
use crate::model::Options;
use crate::model::testing::b1_g2;
use crate::sweep::{Schedule, Step, SweepSpec, Transition};
use twofloat::{TwoFloat as Double, consts};

const DT: f64 = 1.0 / 2048.0;
/// Terms of a series: the fastest rate (a tip, 350 1/s) times a sample is 0.17.
const TERMS: usize = 22;
/// Places within a sample at which corners are looked for.
const PLACES: usize = 4;
/// A corner that has just been turned is off by rounding.
const ROUNDING: f64 = -1e-26;
const MASS: f64 = 500.0;
const DAMPING: f64 = 1100.0;
const HALF_GAP: f64 = 0.010;
const KNEES: [f64; 2] = [0.008, 0.040];
const SLOPES: [f64; 3] = [20e3, 18e3, 2e3];

fn wide(x: f64) -> Double {
    Double::from(x)
}

/// Motion of mass and tips over a stretch, as power series.
struct Path {
    d: [Double; TERMS],
    tips: [[Double; TERMS]; 2],
}

#[derive(Clone, Copy)]
struct State {
    d: Double,
    v: Double,
    tips: [Double; 2],
}

impl Path {
    fn at(&self, t: Double) -> State {
        let (mut d, mut v) = (wide(0.0), wide(0.0));
        for term in self.d.iter().rev() {
            v = v * t + d;
            d = d * t + *term;
        }
        let tips = self.tips.map(|tip| {
            if tip[0].hi() == 0.0 {
                return wide(0.0);
            }
            tip.iter().rev().fold(wide(0.0), |sum, term| sum * t + *term)
        });
        State { d, v, tips }
    }
}

struct Precise {
    now: State,
    bumper: (f64, f64),
    contact: [bool; 2],
    segment: i32,
    contacts: usize,
    amplitude: f64,
    w: Double,
    /// Sine and cosine of the phase.
    phase: (Double, Double),
}

impl Precise {
    fn intercept(&self) -> Double {
        let mut force = wide(0.0);
        for i in 0..self.segment.unsigned_abs() as usize {
            force += wide(KNEES[i]) * (SLOPES[i] - SLOPES[i + 1]);
        }
        if self.segment < 0 { -force } else { force }
    }

    /// Stiffness, damping and constant force over the mass.
    fn piece(&self) -> [Double; 3] {
        let mut sum = [wide(SLOPES[self.segment.unsigned_abs() as usize]), wide(DAMPING), self.intercept()];
        for side in 0..2 {
            if self.contact[side] {
                let sign = 1.0 - 2.0 * side as f64;
                sum[0] += self.bumper.0;
                sum[1] += self.bumper.1;
                sum[2] -= wide(HALF_GAP) * (sign * self.bumper.0);
            }
        }
        sum.map(|part| part / MASS)
    }

    fn path(&self) -> Path {
        let [stiffness, damping, constant] = self.piece();
        let mut d = [wide(0.0); TERMS];
        (d[0], d[1]) = (self.now.d, self.now.v);
        let (mut input, mut next) = (self.phase.0 * self.amplitude, self.phase.1 * self.amplitude);
        for n in 0..TERMS - 2 {
            let m = n as f64;
            let mut force = -input - damping * d[n + 1] * (m + 1.0) - stiffness * d[n];
            if n == 0 {
                force -= constant;
            }
            d[n + 2] = force / ((m + 1.0) * (m + 2.0));
            (input, next) = (next * self.w / (m + 1.0), -(input * self.w) / (m + 1.0));
        }
        let tips = std::array::from_fn(|side| {
            let mut tip = [wide(0.0); TERMS];
            tip[0] = if self.contact[side] || self.now.tips[side].hi() < 1e-40 {
                wide(0.0)
            } else {
                self.now.tips[side]
            };
            let rate = -wide(self.bumper.0) / self.bumper.1;
            for n in 1..TERMS {
                tip[n] = tip[n - 1] * rate / n as f64;
            }
            tip
        });
        Path { d, tips }
    }

    /// Below zero where the regime has ended: knee above, knee below, right, left.
    fn corners(&self, at: &State) -> [Double; 4] {
        let edge = |i: usize| KNEES.get(i).copied().unwrap_or(1e3);
        let index = self.segment.unsigned_abs() as usize;
        let (low, high) = match self.segment {
            0 => (-edge(0), edge(0)),
            s if s > 0 => (KNEES[index - 1], edge(index)),
            _ => (-edge(index), -KNEES[index - 1]),
        };
        let side = |side: usize| {
            let sign = 1.0 - 2.0 * side as f64;
            let (p, rate) = (at.d * sign - HALF_GAP, at.v * sign);
            if self.contact[side] { p * self.bumper.0 + rate * self.bumper.1 } else { at.tips[side] - p }
        };
        [-at.d + high, at.d - low, side(0), side(1)]
    }

    fn failed(&self, at: &State) -> Option<usize> {
        self.corners(at).iter().position(|corner| corner.hi() < ROUNDING)
    }

    /// Free, tips back, and every corner farther than the mass could go and come back.
    fn is_far(&self, end: &State, h: f64) -> bool {
        let way = 2.0 * h * self.now.v.hi().abs().max(end.v.hi().abs()) + 1e-6;
        let still = self.contact == [false; 2] && self.now.tips.iter().all(|tip| tip.hi() < 1e-9);
        still && [&self.now, end].iter().all(|state| self.corners(state).iter().all(|c| c.hi() > way))
    }

    fn advance(&mut self, mut rest: Double) {
        while rest.hi() > 0.0 {
            let path = self.path();
            let end = path.at(rest);
            if self.is_far(&end, rest.hi()) {
                self.go(&path, rest);
                return;
            }
            let place = |i: usize| rest * (i as f64 / PLACES as f64);
            let Some(i) = (1..=PLACES).find(|i| self.failed(&path.at(place(*i))).is_some()) else {
                self.go(&path, rest);
                return;
            };
            let (mut low, mut high) = (place(i - 1), place(i));
            while (high - low).hi() > 1e-30 {
                let middle = (low + high) * 0.5;
                if self.failed(&path.at(middle)).is_some() { high = middle } else { low = middle }
            }
            let corner = self.failed(&path.at(high));
            self.go(&path, high);
            self.turn(corner);
            rest -= high;
        }
    }

    fn go(&mut self, path: &Path, t: Double) {
        self.now = path.at(t);
        let (mut sin, mut cos, mut term) = (wide(0.0), wide(0.0), wide(1.0));
        for n in 0..TERMS {
            let signed = if n % 4 < 2 { term } else { -term };
            if n % 2 == 0 {
                cos += signed
            } else {
                sin += signed
            }
            term = term * self.w * t / (n + 1) as f64;
        }
        let (s, c) = self.phase;
        self.phase = (s * cos + c * sin, c * cos - s * sin);
    }

    fn turn(&mut self, corner: Option<usize>) {
        match corner {
            Some(0) => self.segment += 1,
            Some(1) => self.segment -= 1,
            Some(corner) => {
                let side = corner - 2;
                self.contact[side] = !self.contact[side];
                self.contacts += usize::from(self.contact[side]);
                self.now.tips[side] = self.now.d * (1.0 - 2.0 * side as f64) - HALF_GAP;
            }
            None => {}
        }
    }

    /// D and A now.
    fn seen(&self) -> (f64, f64) {
        let [stiffness, damping, constant] = self.piece();
        let a = -(stiffness * self.now.d + damping * self.now.v + constant);
        (self.now.d.hi(), a.hi())
    }
}

/// D and A at every sample, and the number of contacts.
fn precise(steps: &[Step], bumper: (f64, f64)) -> (Vec<(f64, f64)>, usize) {
    let zero = wide(0.0);
    let mut model = Precise {
        now: State { d: zero, v: zero, tips: [zero; 2] },
        bumper,
        contact: [false; 2],
        segment: 0,
        contacts: 0,
        amplitude: 0.0,
        w: zero,
        phase: (zero, wide(1.0)),
    };
    let (mut out, mut begin) = (vec![(0.0, 0.0)], zero);
    for step in steps {
        model.amplitude = step.acceleration_amplitude_m_s2;
        model.w = consts::TAU * step.frequency_hz;
        model.phase = (zero, wide(1.0));
        let end = begin + wide(f64::from(step.cycles)) / step.frequency_hz;
        let mut now = begin;
        loop {
            let sample = wide(out.len() as f64 * DT);
            if (end - sample).hi() < 0.0 {
                break;
            }
            model.advance(sample - now);
            (now, _) = (sample, out.push(model.seen()));
        }
        model.advance(end - now);
        begin = end;
    }
    (out, model.contacts)
}

#[test]
fn whole_sweeps_of_the_paper_are_right_to_eleven_digits() {
    let sweep = SweepSpec { transition: Transition::None, acceleration_g: 0.05, ..SweepSpec::paper() };
    let schedule = Schedule::new(&sweep).expect("valid");
    let plan = Plan::new(schedule.steps(), DT);
    for (bumper, contacts) in [((33e3, 300.0), 404), ((175e3, 500.0), 500)] {
        let mut spec = b1_g2();
        if let Some(given) = &mut spec.bumper {
            (given.stiffness_n_m, given.damping_n_s_m) = bumper;
        }
        let (reference, counted) = precise(schedule.steps(), bumper);
        let (mut worst_d, mut worst_a) = (0.0_f64, 0.0_f64);
        let mut peaks = vec![StepPeaks::NONE; plan.steps.len()];
        let response =
            simulate_sweep(&spec, schedule.steps(), DT, &Options::default(), &mut |i, step, _, r| {
                let (d, a) = reference[i];
                worst_d = worst_d.max((r.relative_displacement_m - d).abs());
                worst_a = worst_a.max((r.mass_acceleration_m_s2 - a).abs());
                if i >= plan.first_counted(step) {
                    let peak = &mut peaks[step];
                    peak.a_max_m_s2 = peak.a_max_m_s2.max(a.abs());
                    (peak.d_max_m, peak.d_min_m) = (peak.d_max_m.max(d), peak.d_min_m.min(d));
                }
            });
        let response = response.expect("runs");
        assert_eq!((response.contacts, counted), (contacts, contacts));
        assert_eq!((response.samples, reference.len()), (989_542, 989_542));
        let mut worst_peak = 0.0_f64;
        for (found, peak) in response.peaks.iter().zip(&peaks) {
            worst_peak = worst_peak.max((found.a_max_m_s2 / peak.a_max_m_s2 - 1.0).abs());
            worst_peak = worst_peak.max((found.excursion_m() / peak.excursion_m() - 1.0).abs());
        }
        println!("D {worst_d:.1e} m, A {worst_a:.1e} m/s2, peaks {worst_peak:.1e}");
        assert!(worst_d < 1e-11 && worst_a < 1e-8, "D {worst_d} m, A {worst_a} m/s2");
        assert!(worst_peak < 1e-9, "{worst_peak}");
    }
}
