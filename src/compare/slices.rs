//! Sums of squares by where a sample lies, and the tables made of them.

use crate::model::Regime;
use serde::Serialize;
use std::ops::AddAssign;

/// Sums of squares over samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sums {
    /// Samples of the compared channels.
    pub count: f64,
    /// Squared residual and measured acceleration, (m/s2)^2.
    pub a: [f64; 2],
    /// Squared residual and measured displacement, m^2.
    pub d: [f64; 2],
    /// Samples of the residual force.
    pub force_count: f64,
    /// Squared residual and measured restoring force, N^2.
    pub force: [f64; 2],
}

impl AddAssign<&Self> for Sums {
    fn add_assign(&mut self, other: &Self) {
        self.count += other.count;
        self.force_count += other.force_count;
        for i in 0..2 {
            self.a[i] += other.a[i];
            self.d[i] += other.d[i];
            self.force[i] += other.force[i];
        }
    }
}

/// Root of a ratio of sums of squares; `None` when nothing was measured.
pub fn nrmse([residual, measured]: [f64; 2]) -> Option<f64> {
    (measured > 0.0).then(|| (residual / measured).sqrt())
}

/// The misfit of one part of the counted samples.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Slice {
    /// Which part.
    pub name: String,
    /// Its share of the counted samples.
    pub share_of_samples: f64,
    /// RMS residual of A there over the RMS of A there.
    pub nrmse_a: Option<f64>,
    /// The same for D.
    pub nrmse_d: Option<f64>,
    /// Its share of the squared residual of A.
    pub share_of_misfit_a: Option<f64>,
    /// The same for D.
    pub share_of_misfit_d: Option<f64>,
    /// Its share of the squared residual force, where the motion was measured.
    pub share_of_misfit_force: Option<f64>,
    /// RMS residual force there, N.
    pub force_rms_n: Option<f64>,
}

impl Slice {
    /// A named part of a whole.
    pub fn new(name: impl Into<String>, part: &Sums, total: &Sums) -> Self {
        let share = |part: f64, total: f64| (total > 0.0).then(|| part / total);
        Self {
            name: name.into(),
            share_of_samples: share(part.count, total.count)
                .or(share(part.force_count, total.force_count))
                .unwrap_or(0.0),
            nrmse_a: nrmse(part.a),
            nrmse_d: nrmse(part.d),
            share_of_misfit_a: share(part.a[0], total.a[0]),
            share_of_misfit_d: share(part.d[0], total.d[0]),
            share_of_misfit_force: share(part.force[0], total.force[0]),
            force_rms_n: share(part.force[0], part.force_count).map(f64::sqrt),
        }
    }
}

const BRANCHES: usize = 8;
const CELLS: usize = 3 * BRANCHES * 4;

/// Sums by regime, every combination apart.
#[derive(Clone, Debug)]
pub struct Cells(Vec<Sums>);

impl Default for Cells {
    fn default() -> Self {
        Self(vec![Sums::default(); CELLS])
    }
}

/// Where a sample lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Cell {
    /// 0 free, 1 right, 2 left.
    contact: usize,
    branch: usize,
    sticking: bool,
    outward: bool,
}

impl Cell {
    fn of(regime: Regime, outward: bool) -> Self {
        let contact = if regime.right_contact { 1 } else { 2 * usize::from(regime.left_contact) };
        let branch = usize::from(regime.isolator_branch).min(BRANCHES - 1);
        Self { contact, branch, sticking: regime.sticking, outward }
    }

    fn index(self) -> usize {
        ((self.contact * BRANCHES + self.branch) * 2 + usize::from(self.sticking)) * 2
            + usize::from(self.outward)
    }

    fn at(index: usize) -> Self {
        Self {
            contact: index / (4 * BRANCHES),
            branch: index / 4 % BRANCHES,
            sticking: index / 2 % 2 == 1,
            outward: index % 2 == 1,
        }
    }
}

impl Cells {
    /// The sums of the cell of a sample.
    pub fn of(&mut self, regime: Regime, outward: bool) -> &mut Sums {
        &mut self.0[Cell::of(regime, outward).index()]
    }

    fn sum(&self, within: impl Fn(Cell) -> bool) -> Sums {
        let mut sums = Sums::default();
        for (index, part) in self.0.iter().enumerate() {
            if within(Cell::at(index)) {
                sums += part;
            }
        }
        sums
    }

    /// Everything.
    pub fn total(&self) -> Sums {
        self.sum(|_| true)
    }

    /// All parts that have samples: contacts, branches, friction states, directions, and contact by
    /// direction. They overlap.
    pub fn slices(&self) -> Vec<Slice> {
        let total = self.total();
        let mut slices = Vec::new();
        let mut add = |name: String, sums: Sums| {
            if sums.count > 0.0 || sums.force_count > 0.0 {
                slices.push(Slice::new(name, &sums, &total));
            }
        };
        for (contact, name) in ["free", "right-contact", "left-contact"].into_iter().enumerate() {
            add(name.to_owned(), self.sum(|cell| cell.contact == contact));
            if contact > 0 {
                for (outward, way) in [(true, "approaching"), (false, "leaving")] {
                    let within = |cell: Cell| cell.contact == contact && cell.outward == outward;
                    add(format!("{name}-{way}"), self.sum(within));
                }
            }
        }
        for branch in 0..BRANCHES {
            add(format!("isolator-branch-{branch}"), self.sum(|cell| cell.branch == branch));
        }
        if self.sum(|cell| cell.sticking).count > 0.0 {
            add("sticking".to_owned(), self.sum(|cell| cell.sticking));
            add("slipping".to_owned(), self.sum(|cell| !cell.sticking));
        }
        add("moving-outward".to_owned(), self.sum(|cell| cell.outward));
        add("moving-inward".to_owned(), self.sum(|cell| !cell.outward));
        slices
    }

    /// Outward and inward motion, where the regime never changes.
    pub fn ways(&self) -> Vec<(String, Sums)> {
        [(true, "motion away from the middle"), (false, "motion back to the middle")]
            .into_iter()
            .map(|(outward, name)| (name.to_owned(), self.sum(|cell| cell.outward == outward)))
            .collect()
    }

    /// Disjoint parts for the one sentence: contact by direction, free by branch.
    pub fn places(&self) -> Vec<(String, Sums)> {
        let mut places = Vec::new();
        for branch in 0..BRANCHES {
            let name = format!("free motion on branch {branch} of the isolator");
            places.push((name, self.sum(|cell| cell.contact == 0 && cell.branch == branch)));
        }
        for (contact, side) in [(1, "right"), (2, "left")] {
            for (outward, way) in [(true, "approaching"), (false, "leaving")] {
                let within = |cell: Cell| cell.contact == contact && cell.outward == outward;
                places.push((format!("{side} contact while {way}"), self.sum(within)));
            }
        }
        places.retain(|(_, sums)| sums.count > 0.0 || sums.force_count > 0.0);
        places
    }
}
