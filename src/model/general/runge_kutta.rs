//! One step of J. R. Dormand and P. J. Prince, J. Comput. Appl. Math. 6 (1980) 19, with the dense
//! output of E. Hairer, S. P. Norsett and G. Wanner, Solving Ordinary Differential Equations I, 1993.

/// A step that was taken: its end, its error, and what its dense output needs.
#[derive(Clone, Copy, Debug)]
pub struct Step<const N: usize> {
    /// State at the end.
    pub end: [f64; N],
    /// Rates at the end.
    pub rates: [f64; N],
    /// Estimated error of each state.
    pub error: [f64; N],
    dense: [[f64; N]; 4],
    start: [f64; N],
}

impl<const N: usize> Step<N> {
    /// A step of `h` s from `y`, whose rates are `k1`; `f(offset, state)` gives rates and what goes with them. The step, and what goes
    /// with the rates at its end.
    pub fn take<W>(
        h: f64,
        y: &[f64; N],
        k1: &[f64; N],
        f: impl Fn(f64, &[f64; N]) -> ([f64; N], W),
    ) -> (Self, W) {
        let sum = |terms: &[(f64, &[f64; N])]| -> [f64; N] {
            std::array::from_fn(|i| y[i] + h * terms.iter().map(|(a, k)| a * k[i]).sum::<f64>())
        };
        let k2 = f(h / 5.0, &sum(&[(1.0 / 5.0, k1)])).0;
        let k3 = f(0.3 * h, &sum(&[(3.0 / 40.0, k1), (9.0 / 40.0, &k2)])).0;
        let k4 = f(0.8 * h, &sum(&[(44.0 / 45.0, k1), (-56.0 / 15.0, &k2), (32.0 / 9.0, &k3)])).0;
        let k5 = f(
            8.0 / 9.0 * h,
            &sum(&[
                (19372.0 / 6561.0, k1),
                (-25360.0 / 2187.0, &k2),
                (64448.0 / 6561.0, &k3),
                (-212.0 / 729.0, &k4),
            ]),
        )
        .0;
        let k6 = f(
            h,
            &sum(&[
                (9017.0 / 3168.0, k1),
                (-355.0 / 33.0, &k2),
                (46732.0 / 5247.0, &k3),
                (49.0 / 176.0, &k4),
                (-5103.0 / 18656.0, &k5),
            ]),
        )
        .0;
        let end = sum(&[
            (35.0 / 384.0, k1),
            (500.0 / 1113.0, &k3),
            (125.0 / 192.0, &k4),
            (-2187.0 / 6784.0, &k5),
            (11.0 / 84.0, &k6),
        ]);
        let (k7, with) = f(h, &end);
        let error = std::array::from_fn(|i| {
            h * (71.0 / 57600.0 * k1[i] - 71.0 / 16695.0 * k3[i] + 71.0 / 1920.0 * k4[i]
                - 17253.0 / 339_200.0 * k5[i]
                + 22.0 / 525.0 * k6[i]
                - k7[i] / 40.0)
        });
        let difference: [f64; N] = std::array::from_fn(|i| end[i] - y[i]);
        let first: [f64; N] = std::array::from_fn(|i| h * k1[i] - difference[i]);
        let second = std::array::from_fn(|i| difference[i] - h * k7[i] - first[i]);
        let third = std::array::from_fn(|i| {
            h * (-12_715_105_075.0 / 11_282_082_432.0 * k1[i] + 87_487_479_700.0 / 32_700_410_799.0 * k3[i]
                - 10_690_763_975.0 / 1_880_347_072.0 * k4[i]
                + 701_980_252_875.0 / 199_316_789_632.0 * k5[i]
                - 1_453_857_185.0 / 822_651_844.0 * k6[i]
                + 69_997_945.0 / 29_380_423.0 * k7[i])
        });
        let dense = [difference, first, second, third];
        (Self { end, rates: k7, error, dense, start: *y }, with)
    }

    /// State at a part of the step, 0 to 1.
    #[inline]
    pub fn at(&self, part: f64) -> [f64; N] {
        let rest = 1.0 - part;
        let [d, a, b, c] = &self.dense;
        std::array::from_fn(|i| self.start[i] + part * (d[i] + rest * (a[i] + part * (b[i] + rest * c[i]))))
    }
}
