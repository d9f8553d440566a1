//! A field of values over two axes, drawn as coloured cells in a [`Chart`](super::Chart).
//!
//! The colour is told by opacity over the page's own ground, so that light and dark screens both show
//! it; cells without a value stay empty, cells of value zero keep a faint tint.

use plotters::style::RGBAColor;

/// Opacity of a cell of value zero.
const FAINTEST: f64 = 0.07;
/// Cells of the key in the legend, on either side of zero.
const KEY_CELLS: i32 = 6;

/// Values in cells; colours run to the largest magnitude.
#[derive(Clone, Debug)]
pub struct Heat {
    x_edges: Vec<f64>,
    y_edges: Vec<f64>,
    values: Vec<Vec<Option<f64>>>,
    largest: f64,
    signed: bool,
}

impl Heat {
    /// Cells between rising edges; `values` has a row a vertical cell, `None` where there is none.
    /// `signed` gives both signs a colour of their own.
    pub fn new(x_edges: Vec<f64>, y_edges: Vec<f64>, values: Vec<Vec<Option<f64>>>, signed: bool) -> Self {
        let largest = values.iter().flatten().flatten().map(|v| v.abs()).fold(0.0, f64::max);
        Self { x_edges, y_edges, values, largest, signed }
    }

    /// Largest magnitude.
    pub fn largest(&self) -> f64 {
        self.largest
    }

    /// First and last edge of each axis.
    pub(super) fn ranges(&self) -> Option<((f64, f64), (f64, f64))> {
        let range = |edges: &[f64]| Some((*edges.first()?, *edges.last()?));
        Some((range(&self.x_edges)?, range(&self.y_edges)?))
    }

    /// Two opposite corners and the colour of every cell that has a value.
    pub(super) fn cells(&self) -> impl Iterator<Item = ([(f64, f64); 2], RGBAColor)> {
        self.values.iter().zip(self.y_edges.windows(2)).flat_map(move |(row, y)| {
            row.iter().zip(self.x_edges.windows(2)).filter_map(move |(value, x)| {
                let share = (*value)? / self.largest.max(f64::MIN_POSITIVE);
                Some(([(x[0], y[0]), (x[1], y[1])], self.colour(share)))
            })
        })
    }

    /// Colours of the key, lowest first.
    pub(super) fn key(&self) -> Vec<RGBAColor> {
        let from = if self.signed { -KEY_CELLS } else { 0 };
        (from..=KEY_CELLS).map(|i| self.colour(f64::from(i) / f64::from(KEY_CELLS))).collect()
    }

    /// Colour of a share (-1 to 1) of the largest magnitude.
    fn colour(&self, share: f64) -> RGBAColor {
        let opacity = FAINTEST + (1.0 - FAINTEST) * share.abs().min(1.0);
        match (self.signed, share < 0.0) {
            (true, true) => RGBAColor(0x1f, 0x6f, 0xd6, opacity),
            (true, false) => RGBAColor(0xd9, 0x34, 0x2b, opacity),
            (false, _) => RGBAColor(0x8a, 0x3a, 0xb9, opacity),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_without_a_value_are_left_out_and_signs_have_colours() {
        let heat = Heat::new(
            vec![0.0, 1.0, 2.0],
            vec![0.0, 1.0, 3.0],
            vec![vec![Some(-4.0), None], vec![Some(0.0), Some(2.0)]],
            true,
        );
        let cells: Vec<_> = heat.cells().collect();
        assert_eq!(cells.len(), 3);
        assert_eq!(cells[0].0, [(0.0, 0.0), (1.0, 1.0)]);
        assert_eq!(cells[2].0, [(1.0, 1.0), (2.0, 3.0)]);
        assert!(cells[0].1.2 > cells[0].1.0 && cells[0].1.3 == 1.0, "blue, opaque: {:?}", cells[0].1);
        assert!(cells[2].1.0 > cells[2].1.2 && cells[2].1.3 < 0.6, "red, fainter: {:?}", cells[2].1);
        assert_eq!(heat.ranges(), Some(((0.0, 2.0), (0.0, 3.0))));
    }
}
