//! Values over rows and columns as coloured cells with their numbers: errors of many cases at a glance.
//! Campaigns draw it; the colours run from blue (low) over white (zero) to red (high).

use super::ReportError;
use super::page::escape;
use std::fmt::Write as _;

/// Width and height of a cell, px.
const CELL_PX: (f64, f64) = (54.0, 21.0);
/// Room for row names, column names and group names, px.
const LEFT_PX: f64 = 76.0;
const HEAD_PX: f64 = 44.0;
/// Room between groups, px.
const BETWEEN_PX: f64 = 16.0;

/// Name of a group, names of its columns, values by row and column.
pub type HeatGroup = (String, Vec<String>, Vec<Vec<Option<f64>>>);

/// Groups of columns over common rows.
#[derive(Clone, Debug, PartialEq)]
pub struct HeatMap {
    /// Names of the rows.
    pub rows: Vec<String>,
    /// Name, column names, and values by row and column (per cent; `None` leaves a cell empty).
    pub groups: Vec<HeatGroup>,
    /// Value at which the colour is full, per cent.
    pub full: f64,
    /// Values run from 0 to `full` instead of both ways.
    pub one_sided: bool,
    /// Decimals of the numbers.
    pub decimals: usize,
}

impl HeatMap {
    fn colour(&self, value: f64) -> (u8, u8, u8) {
        let share = (value / self.full.max(1e-12)).clamp(-1.0, 1.0);
        let towards = if share < 0.0 { (84.0, 140.0, 214.0) } else { (224.0, 96.0, 84.0) };
        let mix = |end: f64| (255.0 + (end - 255.0) * share.abs()) as u8;
        (mix(towards.0), mix(towards.1), mix(towards.2))
    }

    fn draw(&self, text: &str, background: &str) -> Result<String, ReportError> {
        let columns: usize = self.groups.iter().map(|(_, columns, _)| columns.len()).sum();
        let width = LEFT_PX + columns as f64 * CELL_PX.0 + self.groups.len() as f64 * BETWEEN_PX;
        let height = HEAD_PX + self.rows.len() as f64 * CELL_PX.1 + 6.0;
        let mut svg = format!(
            "<svg width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" \
             xmlns=\"http://www.w3.org/2000/svg\" font-family=\"sans-serif\" font-size=\"12\">{background}"
        );
        self.body(&mut svg, text).map_err(|error| ReportError::Figure {
            figure: "heat map".to_owned(),
            reason: error.to_string(),
        })?;
        svg.push_str("</svg>");
        Ok(svg)
    }

    fn body(&self, svg: &mut String, ink: &str) -> std::fmt::Result {
        for (r, row) in self.rows.iter().enumerate() {
            let y = HEAD_PX + (r as f64 + 0.72) * CELL_PX.1;
            write!(svg, "<text x=\"4\" y=\"{y:.1}\" fill=\"{ink}\">{}</text>", escape(row))?;
        }
        let mut left = LEFT_PX;
        for (name, columns, values) in &self.groups {
            let middle = left + 0.5 * columns.len() as f64 * CELL_PX.0;
            write!(
                svg,
                "<text x=\"{middle:.1}\" y=\"15\" fill=\"{ink}\" text-anchor=\"middle\" font-weight=\"600\">{}</text>",
                escape(name)
            )?;
            for (c, column) in columns.iter().enumerate() {
                let x = left + c as f64 * CELL_PX.0;
                let centre = x + 0.5 * CELL_PX.0;
                write!(
                    svg,
                    "<text x=\"{centre:.1}\" y=\"36\" fill=\"{ink}\" text-anchor=\"middle\">{}</text>",
                    escape(column)
                )?;
                for (r, row) in values.iter().enumerate() {
                    let y = HEAD_PX + r as f64 * CELL_PX.1;
                    let Some(value) = row.get(c).copied().flatten().filter(|v| v.is_finite()) else {
                        continue;
                    };
                    let (red, green, blue) = self.colour(value);
                    let sign = if self.one_sided || value < 0.0 { "" } else { "+" };
                    write!(
                        svg,
                        "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"#{red:02x}{green:02x}{blue:02x}\" \
                         data-value=\"{value}\"/><text x=\"{centre:.1}\" y=\"{:.1}\" text-anchor=\"middle\" fill=\"#1b1f24\">{sign}{value:.*}</text>",
                        CELL_PX.0 - 1.5,
                        CELL_PX.1 - 1.5,
                        y + 0.7 * CELL_PX.1,
                        self.decimals
                    )?;
                }
            }
            left += columns.len() as f64 * CELL_PX.0 + BETWEEN_PX;
        }
        Ok(())
    }

    /// As an SVG file of its own.
    ///
    /// # Errors
    /// [`ReportError::Figure`].
    pub fn svg(&self) -> Result<String, ReportError> {
        self.draw("#24292f", "<rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>")
    }

    /// As part of a page, with the colours of its style sheet.
    ///
    /// # Errors
    /// [`ReportError::Figure`].
    pub fn inline_svg(&self) -> Result<String, ReportError> {
        self.draw("var(--ink)", "")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_is_drawn_with_its_colour_and_empty_cells_stay_empty() {
        let map = HeatMap {
            rows: vec!["B0".into(), "B1-G1".into()],
            groups: vec![("A_max".into(), vec!["0.03 g".into()], vec![vec![Some(-40.0)], vec![None]])],
            full: 40.0,
            one_sided: false,
            decimals: 1,
        };
        let svg = map.svg().expect("drawn");
        assert!(
            svg.contains("data-value=\"-40\"") && svg.contains(">-40.0<") && svg.contains("#548cd6"),
            "{svg}"
        );
        assert_eq!(svg.matches("data-value").count(), 1);
    }
}
