//! What is known of a linear form at one instant, and what follows from it: within which time it cannot
//! reach zero, until when it does for certain, where about. The event search and the search for peaks use
//! it.

/// Value and derivatives of a form, and what the sizes of two of them will not exceed from here on.
#[derive(Clone, Copy, Debug)]
pub struct Local {
    pub value: f64,
    pub slope: f64,
    pub curvature: f64,
    /// Of the curvature.
    pub bound: f64,
    /// Of the third derivative.
    pub third: f64,
}

impl Local {
    /// Times a number.
    #[inline]
    pub fn times(&self, k: f64) -> Self {
        Self {
            value: k * self.value,
            slope: k * self.slope,
            curvature: k * self.curvature,
            bound: k.abs() * self.bound,
            third: k.abs() * self.third,
        }
    }

    /// Seen backwards in time.
    #[inline]
    pub fn reversed(&self) -> Self {
        Self { slope: -self.slope, ..*self }
    }

    /// Halley's step to the root nearby, s.
    #[inline]
    pub fn halley(&self) -> f64 {
        let bent = 2.0 * self.slope * self.slope - self.value * self.curvature;
        -2.0 * self.value * self.slope / bent
    }

    /// Time within which it stays above zero, by the bound of its curvature.
    #[inline]
    pub fn step(&self) -> f64 {
        self.within(self.bound)
    }

    /// Time within which value + slope t - bound t^2/2 stays above zero.
    #[inline]
    fn within(&self, bound: f64) -> f64 {
        let root = (self.slope * self.slope + 2.0 * bound * self.value).sqrt();
        if self.slope < 0.0 {
            2.0 * self.value / (root - self.slope)
        } else if bound > 0.0 {
            (self.slope + root) / bound
        } else {
            f64::INFINITY
        }
    }

    /// [`Local::step`], farther where the curvature cannot get as large before the root that is in sight.
    #[inline]
    pub fn farther(&self, step: f64) -> f64 {
        let sight = if self.slope < 0.0 {
            1.25 * self.halley()
        } else if self.curvature < 0.0 {
            -2.5 * self.slope / self.curvature
        } else {
            0.0
        };
        let horizon = sight.max(2.0 * step);
        let bound = self.third * horizon - self.curvature;
        if bound < self.bound { self.within(bound.max(0.0)).min(horizon).max(step) } else { step }
    }

    /// Time before which it is below zero for certain, while it falls throughout.
    #[inline]
    pub fn certain(&self) -> Option<f64> {
        let horizon = 1.5 * self.halley();
        let near = self.curvature + self.third * horizon;
        let (bound, horizon) =
            if horizon > 0.0 && near < self.bound { (near, horizon) } else { (self.bound, f64::INFINITY) };
        // value + slope t + bound t^2/2 vanishes.
        let rest = self.slope * self.slope - 2.0 * bound * self.value;
        let end = 2.0 * self.value / (rest.sqrt() - self.slope);
        (self.slope < 0.0 && rest > 0.0 && end <= horizon).then_some(end)
    }
}
