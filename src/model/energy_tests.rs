//! The ledger of energy for every effect: what the table puts in is what is stored and what is lost, each counted
//! by equations of its own along the motion, hidden states included.

use super::effects::CATALOGUE;
use super::effects::fractional_damping::SpringPot;
use super::testing::{b1_g2, effect};
use super::{BumperSpec, EffectSpec, ModelSpec, Response, build};
use proptest::prelude::*;
use std::f64::consts::TAU;

/// Name, parameters, and the part of the turnover that the ledger may miss.
type Candidate<'a> = (&'a str, &'a [(&'a str, f64)], f64);

/// Every effect that acts on the motion, at a strength from 0 to 1, and the part of the turnover that its ledger may
/// miss: what is hidden is followed sample by sample here, by first-order rules where the motion has corners.
pub(super) fn candidates(strength: f64) -> Vec<(EffectSpec, f64)> {
    let s = strength;
    let list: [Candidate<'_>; 19] = [
        ("coulomb-friction", &[("fc_n", 60.0 * s)], 2e-6),
        ("stribeck-friction", &[("fc_n", 40.0 * s), ("fs_n", 60.0 * s), ("vs_m_s", 0.02)], 2e-6),
        ("quadratic-damping", &[("c2_n_s2_m2", 5e3 * s)], 2e-6),
        ("cubic-stiffness", &[("k3_n_m3", 2e7 * s)], 2e-6),
        ("bouc-wen-hysteresis", &[("kh_n_m", 1e4 * s), ("dy_m", 3e-3)], 1e-5),
        (
            "iwan-hysteresis",
            &[("kp_n_m", 1e4 * s), ("exponent", -0.4), ("yield_min_m", 2e-4), ("yield_max_m", 0.01)],
            1e-4,
        ),
        ("maxwell-branch", &[("km_n_m", 1e4 * s), ("tau_s", 0.1)], 1e-5),
        ("fractional-damping", &[("ca", 3e3 * s), ("alpha", 0.4)], 2e-4),
        ("stiffness-degradation", &[("delta", 0.5 * s), ("tau_s", 2.0)], 1e-5),
        ("backlash", &[("b_m", 4e-3 * s)], 2e-3),
        ("hertz-contact", &[("kh", 1e6 * s), ("n", 1.5)], 2e-6),
        ("hunt-crossley-damping", &[("mu_n_s_m2", 3e5 * s)], 5e-4),
        ("bumper-stiffening", &[("kb3_n_m3", 1e9 * s)], 2e-6),
        ("bumper-preload", &[("f0_n", 50.0 * s)], 2e-6),
        ("gap-asymmetry", &[("s_m", 1e-3 * s)], 2e-6),
        ("stand-compliance", &[("ks_n_m", 1e6), ("ms_kg", 40.0 * s), ("zeta", 0.03)], 1e-3),
        ("constant-force", &[("f_n", 40.0 * s)], 2e-6),
        ("mass-error", &[("dm_kg", 30.0 * s)], 2e-6),
        ("table-interaction", &[("m_eff_inv_1_kg", 5e-4 * s)], 1e-5),
    ];
    let mut list: Vec<(EffectSpec, f64)> =
        list.into_iter().map(|(name, parameters, missed)| (effect(name, parameters), missed)).collect();
    let mut own = effect("expression", &[("k_n_m3", 2e7 * s), ("c_n_s3_m3", 2e4 * s)]);
    own.expression = Some("k_n_m3*d^3 + c_n_s3_m3*v^3".into());
    list.push((own, 2e-6));
    list
}

#[test]
fn the_ledger_knows_every_effect_that_acts_on_the_motion() {
    let known: Vec<String> = candidates(0.5).into_iter().map(|(effect, _)| effect.name).collect();
    for entry in CATALOGUE.iter().filter(|entry| !entry.is_instrument()) {
        assert!(known.iter().any(|name| name == entry.name), "{}", entry.name);
    }
}

/// One model with one effect, and everything about it that no response tells.
struct Ledger {
    spec: ModelSpec,
    mass_kg: f64,
    dt: f64,
    time_s: f64,
    lost: f64,
    /// Displacement of the isolator behind a joint, m.
    element: f64,
    /// z of Bouc-Wen, u of a Maxwell branch, m.
    hidden: f64,
    /// Jenkins elements: stiffness, yield, slip.
    sliders: Vec<[f64; 3]>,
    /// Relaxing branches: rate, weight, state.
    branches: Vec<[f64; 3]>,
    /// Stiffness of those that have not relaxed, damping of those that have: N/m and N s/m.
    springpot_ends: (f64, f64),
    /// Stands: displacement and velocity.
    stands: [[f64; 2]; 2],
    /// Work that goes into other masses than the specimen's, J.
    aside: f64,
}

impl Ledger {
    fn new(spec: &ModelSpec, dt: f64) -> Self {
        let mut ledger = Self {
            spec: spec.clone(),
            mass_kg: spec.mass_kg,
            dt,
            time_s: dt,
            lost: 0.0,
            element: 0.0,
            hidden: 0.0,
            sliders: Vec::new(),
            branches: Vec::new(),
            springpot_ends: (0.0, 0.0),
            stands: [[0.0; 2]; 2],
            aside: 0.0,
        };
        ledger.mass_kg += ledger.of("mass-error", "dm_kg");
        if let Some([kp, exponent, low, high]) =
            ledger.all("iwan-hysteresis", ["kp_n_m", "exponent", "yield_min_m", "yield_max_m"])
        {
            // Elements of equal stiffness.
            let (n, m) = (1500, exponent + 1.0);
            let at = |i: usize| {
                let part = (i as f64 + 0.5) / n as f64;
                (low.powf(m) + part * (high.powf(m) - low.powf(m))).powf(1.0 / m)
            };
            ledger.sliders = (0..n).map(|i| [kp / n as f64, at(i), 0.0]).collect();
        }
        if let Some([ca, alpha]) = ledger.all("fractional-damping", ["ca", "alpha"]) {
            // The effect's own rates: what is counted here is their energy, not how well they stand for a springpot.
            let own = SpringPot::new(ca, alpha, (dt, 0.0));
            ledger.branches =
                own.rates.into_iter().zip(own.weights).map(|(rate, w)| [rate, w, 0.0]).collect();
            ledger.springpot_ends = (own.stiffness, own.damping);
        }
        ledger
    }

    fn of(&self, name: &str, key: &str) -> f64 {
        self.spec.effects.iter().find(|e| e.name == name).map_or(0.0, |e| e.parameters[key])
    }

    fn all<const N: usize>(&self, name: &str, keys: [&str; N]) -> Option<[f64; N]> {
        self.spec.effects.iter().find(|e| e.name == name).map(|e| keys.map(|key| e.parameters[key]))
    }

    fn softened(&self) -> f64 {
        let [delta, tau] = self.all("stiffness-degradation", ["delta", "tau_s"]).unwrap_or([0.0, 1.0]);
        1.0 - delta * (1.0 - (-self.time_s / tau).exp())
    }

    /// Elastic energy and force of the isolator before any softening.
    fn isolator(&self, d: f64) -> (f64, f64) {
        let (slopes, knees) = (&self.spec.isolator.stiffness_n_m, &self.spec.isolator.breakpoints_m);
        let (mut energy, mut force, mut inner) = (0.0, 0.0, 0.0);
        for (i, slope) in slopes.iter().enumerate() {
            let way = (knees.get(i).copied().unwrap_or(f64::INFINITY).min(d.abs()) - inner).max(0.0);
            energy += force * way + 0.5 * slope * way * way;
            force += slope * way;
            inner += way;
        }
        (energy, force.copysign(d))
    }

    fn penetration(&self, d: f64) -> f64 {
        let shift = self.of("gap-asymmetry", "s_m");
        let half = self.spec.bumper.as_ref().map_or(f64::INFINITY, |b| 0.5 * b.total_gap_m);
        (d - half + shift).max(-d - half - shift).max(0.0)
    }

    /// Energy of a bumper pressed in by p.
    fn bumper(&self, p: f64) -> f64 {
        let linear = self.spec.bumper.as_ref().map_or(0.0, |b| b.stiffness_n_m);
        match self.all("hertz-contact", ["kh", "n"]) {
            Some([kh, n]) => kh * p.powf(n + 1.0) / (n + 1.0),
            None => {
                0.5 * linear * p * p
                    + 0.25 * self.of("bumper-stiffening", "kb3_n_m3") * p.powi(4)
                    + self.of("bumper-preload", "f0_n") * p
            }
        }
    }

    fn stored(&self, now: &Response) -> f64 {
        let (d, v) = (now.relative_displacement_m, now.relative_velocity_m_s);
        let jointed = self.all("backlash", ["b_m"]).is_some();
        let p = self.penetration(d);
        let touches = now.regime.right_contact || now.regime.left_contact;
        let sliders: f64 = self.sliders.iter().map(|[k, _, slip]| 0.5 * k * (d - slip).powi(2)).sum();
        let branches: f64 = self.branches.iter().map(|[_, weight, u]| 0.5 * weight * u * u).sum();
        let mut energy = 0.5 * self.mass_kg * v * v
            + self.softened() * self.isolator(if jointed { self.element } else { d }).0
            + 0.25 * (self.of("cubic-stiffness", "k3_n_m3") + self.of("expression", "k_n_m3")) * d.powi(4)
            + self.of("constant-force", "f_n") * d
            + 0.5 * self.of("bouc-wen-hysteresis", "kh_n_m") * self.hidden * self.hidden
            + 0.5 * self.of("maxwell-branch", "km_n_m") * self.hidden * self.hidden
            + 0.5 * self.springpot_ends.0 * d * d
            + sliders
            + branches;
        if let Some([ks, ms]) = self.all("stand-compliance", ["ks_n_m", "ms_kg"]) {
            let stiffness = self.spec.bumper.as_ref().map_or(1.0, |b| b.stiffness_n_m);
            let push = now.right_contact_force_n.powi(2) + now.left_contact_force_n.powi(2);
            energy += 0.5 * push / stiffness;
            energy += self.stands.iter().map(|[u, rate]| 0.5 * (ks * u * u + ms * rate * rate)).sum::<f64>();
        } else if touches || self.of("hunt-crossley-damping", "mu_n_s_m2") == 0.0 {
            // What the platen's own motion takes is done by the contact force, in proportion.
            energy += (1.0 + self.mass_kg * self.of("table-interaction", "m_eff_inv_1_kg")) * self.bumper(p);
        }
        energy
    }

    /// Power that is lost at a velocity, without hidden states, W.
    fn power(&self, v: f64) -> f64 {
        let [fc, fs, vs] =
            self.all("stribeck-friction", ["fc_n", "fs_n", "vs_m_s"]).unwrap_or([0.0, 0.0, 1.0]);
        let dry = self.of("coulomb-friction", "fc_n") + fc + (fs - fc) * (-(v / vs).powi(2)).exp();
        let jointed = self.all("backlash", ["b_m"]).is_some();
        let viscous = if jointed { 0.0 } else { self.spec.isolator.damping_n_s_m };
        (viscous + self.springpot_ends.1) * v * v
            + dry * v.abs()
            + self.of("quadratic-damping", "c2_n_s2_m2") * v.abs().powi(3)
            + self.of("expression", "c_n_s3_m3") * v.powi(4)
    }

    /// One sample: `a` is the table acceleration at both ends.
    fn advance(&mut self, before: &Response, now: &Response, a: [f64; 2]) {
        let (d0, v0) = (before.relative_displacement_m, before.relative_velocity_m_s);
        let (d1, v1) = (now.relative_displacement_m, now.relative_velocity_m_s);
        // The velocity in the middle of the cubic through both ends.
        let middle = 1.5 * (d1 - d0) / self.dt - 0.25 * (v0 + v1);
        let simpson = |f: &dyn Fn(f64) -> f64| self.dt / 6.0 * (f(v0) + 4.0 * f(middle) + f(v1));
        self.lost += simpson(&|v| self.power(v));
        self.soften(d0, d1);
        self.hysteresis(d0, d1);
        self.relax([v0, middle, v1]);
        self.play(d0, d1);
        self.press(before, now, [v0, middle, v1]);
        self.shake(before, now, a);
        self.time_s += self.dt;
    }

    fn soften(&mut self, d0: f64, d1: f64) {
        let Some([delta, tau]) = self.all("stiffness-degradation", ["delta", "tau_s"]) else { return };
        let rate = |t: f64| delta / tau * (-t / tau).exp();
        let ends = [(self.time_s, d0), (self.time_s + self.dt, d1)];
        self.lost += 0.5 * self.dt * ends.map(|(t, d)| rate(t) * self.isolator(d).0).iter().sum::<f64>();
    }

    fn hysteresis(&mut self, d0: f64, d1: f64) {
        if let Some([kh, dy]) = self.all("bouc-wen-hysteresis", ["kh_n_m", "dy_m"]) {
            let way = d1 - d0;
            // Shape 0.5 and 0.5, sharpness 1: no loss while z returns.
            let yielding = |z: f64| if z * way > 0.0 { (z / dy).abs() } else { 0.0 };
            let z0 = self.hidden;
            let half = z0 + 0.5 * way * (1.0 - yielding(z0));
            let z1 = z0 + way * (1.0 - yielding(half));
            let work = |z: f64| kh * z * yielding(z) * way;
            self.lost += (work(z0) + 4.0 * work(half) + work(z1)) / 6.0;
            self.hidden = z1;
        }
        for [k, most, slip] in &mut self.sliders {
            let beyond = (d1 - *slip).abs() - *most;
            if beyond > 0.0 {
                self.lost += *k * *most * beyond;
                *slip += beyond.copysign(d1 - *slip);
            }
        }
    }

    /// u' = v - rate u, the velocity a parabola.
    fn relax(&mut self, v: [f64; 3]) {
        let dt = self.dt;
        let after = |u: f64, rate: f64| {
            let x = rate * dt;
            let (half, whole) = ((-0.5 * x).exp(), (-x).exp());
            whole * u + dt / 6.0 * (whole * v[0] + 4.0 * half * v[1] + v[2])
        };
        if let Some([km, tau]) = self.all("maxwell-branch", ["km_n_m", "tau_s"]) {
            let u = after(self.hidden, 1.0 / tau);
            self.lost += 0.5 * dt * km / tau * (self.hidden * self.hidden + u * u);
            self.hidden = u;
        }
        for [rate, weight, state] in &mut self.branches {
            let u = after(*state, *rate);
            self.lost += 0.5 * dt * *weight * *rate * (*state * *state + u * u);
            *state = u;
        }
    }

    /// The isolator relaxes against its own dashpot within the play, and is pushed beyond.
    fn play(&mut self, _d0: f64, d1: f64) {
        let Some([b]) = self.all("backlash", ["b_m"]) else { return };
        let c = self.spec.isolator.damping_n_s_m;
        let e0 = self.element;
        let middle = e0 - 0.5 * self.dt * self.isolator(e0).1 / c;
        let free = e0 - self.dt * self.isolator(middle).1 / c;
        self.element = free.clamp(d1 - 0.5 * b, d1 + 0.5 * b);
        self.lost += c * (self.element - e0).powi(2) / self.dt;
    }

    /// A bumper whose damping is its own: the tip keeps what it holds when it is let go, and loses it on its way back.
    fn press(&mut self, before: &Response, now: &Response, v: [f64; 3]) {
        let mu = self.of("hunt-crossley-damping", "mu_n_s_m2");
        let touched = |response: &Response| response.regime.right_contact || response.regime.left_contact;
        if mu == 0.0 {
            return;
        }
        let [p0, p1] = [before, now].map(|response| self.penetration(response.relative_displacement_m));
        match (touched(before), touched(now)) {
            (true, false) => self.lost += self.bumper(p1),
            (false, true) => self.lost -= self.bumper(p0),
            _ => {}
        }
        if touched(before) || touched(now) {
            let power = |p: f64, v: f64| mu * p * v * v;
            self.lost +=
                self.dt / 6.0 * (power(p0, v[0]) + 4.0 * power(0.5 * (p0 + p1), v[1]) + power(p1, v[2]));
        }
    }

    /// The stands, moved by the contact forces and the table.
    fn shake(&mut self, before: &Response, now: &Response, a: [f64; 2]) {
        let Some([ks, ms, zeta]) = self.all("stand-compliance", ["ks_n_m", "ms_kg", "zeta"]) else { return };
        let (c, dt) = (2.0 * zeta * (ks * ms).sqrt(), self.dt);
        let pushes = [
            [before.right_contact_force_n, now.right_contact_force_n],
            [-before.left_contact_force_n, -now.left_contact_force_n],
        ];
        for (stand, push) in self.stands.iter_mut().zip(pushes) {
            let rates = |part: f64, [u, rate]: [f64; 2]| {
                let at = |ends: [f64; 2]| ends[0] + part * (ends[1] - ends[0]);
                [rate, (at(push) - ks * u - c * rate) / ms - at(a)]
            };
            let on = |y: [f64; 2], k: [f64; 2], h: f64| [y[0] + h * k[0], y[1] + h * k[1]];
            let y = *stand;
            let k1 = rates(0.0, y);
            let k2 = rates(0.5, on(y, k1, 0.5 * dt));
            let k3 = rates(0.5, on(y, k2, 0.5 * dt));
            let k4 = rates(1.0, on(y, k3, dt));
            let end: [f64; 2] =
                std::array::from_fn(|i| y[i] + dt / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]));
            self.lost += 0.5 * dt * c * (y[1] * y[1] + end[1] * end[1]);
            self.aside -= 0.5 * dt * ms * (a[0] * y[1] + a[1] * end[1]);
            *stand = end;
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    /// Work of the table = energy stored + energy lost, for random parameters, inputs and periods.
    #[test]
    fn work_in_is_what_is_stored_and_lost(
        which in 0_usize..21,
        stiffness in 5e3_f64..50e3,
        softening in 0.2_f64..1.0,
        damping in 0.0_f64..2000.0,
        gap in 0.004_f64..0.03,
        bumper in 1e4_f64..4e5,
        (amplitude, hz, chirp) in (0.2_f64..1.2, 0.5_f64..3.0, 0.0_f64..0.5),
        rate_hz in 4096.0_f64..16384.0,
        strength in 0.1_f64..1.0,
    ) {
        let mut spec = b1_g2();
        spec.isolator.stiffness_n_m = vec![stiffness, softening * stiffness, 0.1 * stiffness];
        // A bumper without damping keeps what it takes up.
        spec.bumper = Some(BumperSpec { stiffness_n_m: bumper, damping_n_s_m: 0.0, total_gap_m: gap });
        let added = candidates(strength).into_iter().nth(which);
        let missed = added.as_ref().map_or(2e-6, |(_, missed)| *missed);
        spec.effects.extend(added.map(|(effect, _)| effect));
        // Behind a joint a spring without a dashpot would come back at once.
        let least = if spec.effects.iter().any(|e| e.name == "backlash") { 300.0 } else { 0.0 };
        spec.isolator.damping_n_s_m = damping.max(least);
        let dt = 1.0 / rate_hz;
        let mut specimen = build(&spec, dt).expect("builds");
        specimen.reset();
        specimen.impose(0.0, 0.0);
        specimen.prime(0.0);
        let table = |i: u32| {
            let t = f64::from(i) * dt;
            amplitude * (TAU * (hz + chirp * t) * t).sin()
        };
        let mut ledger = Ledger::new(&spec, dt);
        let (mut before, mut a0) = (Response::default(), 0.0);
        let start = ledger.stored(&before);
        let (mut work, mut turnover) = (0.0, 0.0);
        for i in 1..=(6.0 * rate_hz) as u32 {
            let a1 = table(i);
            let now = specimen.step(a1);
            let (d0, v0) = (before.relative_displacement_m, before.relative_velocity_m_s);
            let (d1, v1) = (now.relative_displacement_m, now.relative_velocity_m_s);
            // The table's acceleration runs straight, so -M a v integrates by parts over D.
            let (mid, chord) = (0.5 * (d0 + d1) + dt / 12.0 * (v0 - v1), (a1 - a0) / dt);
            work -= ledger.mass_kg * (a1 * d1 - a0 * d0 - chord * mid * dt);
            ledger.advance(&before, &now, [a0, a1]);
            let energy = ledger.stored(&now) - start;
            let input = work + ledger.aside;
            turnover = f64::max(turnover, energy.abs() + ledger.lost);
            prop_assert!(
                (input - ledger.lost - energy).abs() <= missed * turnover + 1e-9,
                "{:?} {i}: in {input} lost {} stored {energy} J", spec.effects, ledger.lost
            );
            (before, a0) = (now, a1);
        }
    }
}
