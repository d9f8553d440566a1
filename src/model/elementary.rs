//! Sine, cosine and exponential without calls, tables or changes of the rounding mode, for the event
//! search and the harmonics of long records, which spend their time in them; within two units in the last place of the standard library's.

/// Largest argument, rad or 1; beyond it the standard library is asked.
const LARGEST: f64 = 1e5;
/// 2/pi.
const TWO_OVER_PI: f64 = std::f64::consts::FRAC_2_PI;
/// pi/2 in two parts, the first of 33 bits, so that its multiples are exact (W. J. Cody and W. Waite,
/// Software Manual for the Elementary Functions, 1980).
const HALF_PI: [f64; 2] = [1.570_796_326_734_125_6, 6.077_100_506_506_192e-11];
/// ln 2 likewise.
const LN_2: [f64; 2] = [6.931_471_803_691_238e-1, 1.908_214_929_270_587_7e-10];
/// Polynomials of sine and cosine on (-pi/4, pi/4): FDLIBM, Sun Microsystems 1993, k_sin.c and k_cos.c.
const SINE: [[f64; 2]; 3] = [
    [-1.666_666_666_666_663_2e-1, 8.333_333_333_322_49e-3],
    [-1.984_126_982_985_795e-4, 2.755_731_370_707_006_8e-6],
    [-2.505_076_025_340_686_3e-8, 1.589_690_995_211_55e-10],
];
const COSINE: [[f64; 2]; 3] = [
    [4.166_666_666_666_66e-2, -1.388_888_888_887_411e-3],
    [2.480_158_728_947_673e-5, -2.755_731_435_139_066_3e-7],
    [2.087_572_321_298_175e-9, -1.135_964_755_778_819_5e-11],
];
/// 1/2!, 1/3!, ... on (-ln 2/2, ln 2/2); the first term left out is below 1e-17.
const TAYLOR: [[f64; 2]; 6] = [
    [1.0 / 2.0, 1.0 / 6.0],
    [1.0 / 24.0, 1.0 / 120.0],
    [1.0 / 720.0, 1.0 / 5_040.0],
    [1.0 / 40_320.0, 1.0 / 362_880.0],
    [1.0 / 3_628_800.0, 1.0 / 39_916_800.0],
    [1.0 / 479_001_600.0, 1.0 / 6_227_020_800.0],
];
/// 1.5 * 2^52: added and taken away again it rounds to the nearest whole number.
const ROUND: f64 = 6_755_399_441_055_744.0;

/// Terms in pairs, in powers of z^2: half as long a chain of dependent operations as Horner's.
#[inline]
fn polynomial<const N: usize>(z: f64, terms: &[[f64; 2]; N]) -> f64 {
    let square = z * z;
    terms.iter().rev().fold(0.0, |sum, [even, odd]| sum * square + (even + odd * z))
}

/// Sine and cosine.
#[inline]
pub fn sin_cos(x: f64) -> (f64, f64) {
    if x.is_nan() || x.abs() > LARGEST {
        return x.sin_cos();
    }
    let turns = (x * TWO_OVER_PI + ROUND) - ROUND;
    let r = (x - turns * HALF_PI[0]) - turns * HALF_PI[1];
    let z = r * r;
    let sin = r + r * z * polynomial(z, &SINE);
    let half = 0.5 * z;
    let near = 1.0 - half;
    let cos = near + (((1.0 - near) - half) + z * z * polynomial(z, &COSINE));
    // By bits, since which quarter it is cannot be foreseen: swapped where it is odd, signs where it is late.
    let quarter = turns as i64 as u64;
    let (sin, cos) = (sin.to_bits(), cos.to_bits());
    let swap = (sin ^ cos) & (quarter & 1).wrapping_neg();
    let sign = |quarter: u64| (quarter & 2) << 62;
    (f64::from_bits(sin ^ swap ^ sign(quarter)), f64::from_bits(cos ^ swap ^ sign(quarter.wrapping_add(1))))
}

/// Exponential.
#[inline]
pub fn exp(x: f64) -> f64 {
    if x.is_nan() || x.abs() > 700.0 {
        return x.exp();
    }
    let powers = (x * std::f64::consts::LOG2_E + ROUND) - ROUND;
    let r = (x - powers * LN_2[0]) - powers * LN_2[1];
    let value = 1.0 + (r + r * r * polynomial(r, &TAYLOR));
    value * f64::from_bits(((1023 + powers as i64) as u64) << 52)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_agree_with_the_standard_library_to_the_last_bits() {
        let ulp = f64::EPSILON;
        for i in -200_000..200_000 {
            let x = 1e-3 * f64::from(i) + 1e-9 * f64::from(i % 77);
            let ((s, c), (sin, cos)) = (sin_cos(x), x.sin_cos());
            assert!((s - sin).abs() <= ulp && (c - cos).abs() <= ulp, "{x}: {s} {sin}, {c} {cos}");
            let (e, exact) = (exp(x), x.exp());
            assert!((e - exact).abs() <= 2.0 * ulp * exact, "{x}: {e} {exact}");
        }
        for x in [0.0, -0.0, 1e-300, 99_999.0, 1e6, -701.0, 710.0] {
            let ((s, c), (sin, cos)) = (sin_cos(x), x.sin_cos());
            assert!((s - sin).abs() <= 1e-10 && (c - cos).abs() <= 1e-10, "{x}");
            assert!((exp(-x.abs()) - (-x.abs()).exp()).abs() <= 2.0 * ulp, "{x}");
        }
        assert!(sin_cos(f64::NAN).0.is_nan() && exp(f64::INFINITY).is_infinite());
    }
}
