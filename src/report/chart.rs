//! One plot: axes with units, lines, points, legend. Drawn by `plotters` into SVG.

use super::ReportError;
use super::heat::Heat;
use super::style::{Dash, GRID, Ink, Stroke, TEXT, resolve, stand_in};
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// The library draws on whole pixels: it gets a canvas this many times larger, so that curves stay
/// smooth.
const SCALE: f64 = 8.0;
/// Height of the legend's row, px.
const LEGEND_PX: f64 = 22.0;
/// Size of text, px.
const TEXT_PX: f64 = 13.0;
/// Typical width of a character over the size of its text.
const CHARACTER: f64 = 0.53;

/// Shape of a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Marker {
    /// Filled circle.
    Circle,
    /// Open square.
    Square,
    /// Cross.
    Cross,
    /// Triangle.
    Triangle,
}

#[derive(Clone, Debug)]
enum Item {
    Line { points: Vec<(f64, f64)>, stroke: Stroke },
    Points { points: Vec<(f64, f64)>, ink: Ink, marker: Marker, radius_px: f64 },
    Level { y: f64, stroke: Stroke },
    Cells(Heat),
}

impl Item {
    fn points(&self) -> &[(f64, f64)] {
        match self {
            Self::Line { points, .. } | Self::Points { points, .. } => points,
            Self::Level { .. } | Self::Cells(_) => &[],
        }
    }
}

/// A plot under construction. Points that are not finite break a line.
#[derive(Clone, Debug)]
pub struct Chart {
    x_label: String,
    y_label: String,
    width_px: f64,
    height_px: f64,
    x_range: Option<(f64, f64)>,
    y_range: Option<(f64, f64)>,
    x_names: Vec<String>,
    items: Vec<(Option<String>, Item)>,
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

impl Chart {
    /// A plot of 560 by 340 px with these axis labels (units included).
    pub fn new(x_label: &str, y_label: &str) -> Self {
        Self {
            x_label: x_label.to_owned(),
            y_label: y_label.to_owned(),
            width_px: 560.0,
            height_px: 340.0,
            x_range: None,
            y_range: None,
            x_names: Vec::new(),
            items: Vec::new(),
        }
    }

    /// Another size, px.
    #[must_use]
    pub fn size(mut self, width_px: f64, height_px: f64) -> Self {
        (self.width_px, self.height_px) = (width_px.max(120.0), height_px.max(100.0));
        self
    }

    /// A fixed range of the horizontal axis; otherwise that of the data.
    #[must_use]
    pub fn x_range(mut self, low: f64, high: f64) -> Self {
        self.x_range = Some((low, high));
        self
    }

    /// Names in place of the numbers 0, 1, 2 ... of the horizontal axis.
    #[must_use]
    pub fn x_names<S: Into<String>>(mut self, names: impl IntoIterator<Item = S>) -> Self {
        self.x_names = names.into_iter().map(Into::into).collect();
        self.x_range = Some((-0.5, self.x_names.len() as f64 - 0.5));
        self
    }

    /// A fixed range of the vertical axis; otherwise that of the data with a margin.
    #[must_use]
    pub fn y_range(mut self, low: f64, high: f64) -> Self {
        self.y_range = Some((low, high));
        self
    }

    /// Adds a line; with a label it appears in the legend.
    #[must_use]
    pub fn line(mut self, label: Option<&str>, stroke: Stroke, points: Vec<(f64, f64)>) -> Self {
        self.items.push((label.map(str::to_owned), Item::Line { points, stroke }));
        self
    }

    /// Adds points; with a label they appear in the legend.
    #[must_use]
    pub fn points(
        mut self,
        label: Option<&str>,
        ink: Ink,
        marker: Marker,
        radius_px: f64,
        points: Vec<(f64, f64)>,
    ) -> Self {
        self.items.push((label.map(str::to_owned), Item::Points { points, ink, marker, radius_px }));
        self
    }

    /// Adds a horizontal line over the whole width, drawn when it lies within the vertical range of the
    /// rest; it does not widen that range.
    #[must_use]
    pub fn level(mut self, label: Option<&str>, stroke: Stroke, y: f64) -> Self {
        self.items.push((label.map(str::to_owned), Item::Level { y, stroke }));
        self
    }

    /// Adds coloured cells, below what is added later; the axes span them. `unit` is that of the values.
    #[must_use]
    pub fn heat(mut self, label: &str, unit: &str, heat: Heat) -> Self {
        if let Some((x, y)) = heat.ranges() {
            (self.x_range, self.y_range) = (Some(x), Some(y));
        }
        let text = format!("{label}, up to {} {unit}", figure(heat.largest()));
        self.items.push((Some(text), Item::Cells(heat)));
        self
    }

    /// The plot as an SVG file of its own, with fixed colours on white.
    ///
    /// # Errors
    /// [`ReportError::Figure`] when the plotting library refuses.
    pub fn svg(&self) -> Result<String, ReportError> {
        let svg = resolve(&self.draw()?, false, SCALE);
        Ok(svg.replacen('>', "><rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>", 1))
    }

    /// The plot as part of a page, with the colours of its style sheet.
    ///
    /// # Errors
    /// [`ReportError::Figure`] when the plotting library refuses.
    pub fn inline_svg(&self) -> Result<String, ReportError> {
        Ok(resolve(&self.draw()?, true, SCALE))
    }

    fn draw(&self) -> Result<String, ReportError> {
        let mut svg = String::new();
        let size = ((self.width_px * SCALE) as u32, (self.height_px * SCALE) as u32);
        let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        self.draw_on(&area).map_err(|error| ReportError::Figure {
            figure: self.y_label.clone(),
            reason: error.to_string(),
        })?;
        drop(area);
        let (w, h) = size;
        let opening = format!("<svg width=\"{w}\" height=\"{h}\" ");
        let scaled = format!("<svg width=\"{}\" height=\"{}\" ", self.width_px, self.height_px);
        Ok(svg.replacen(&opening, &scaled, 1))
    }

    fn draw_on(&self, area: &Area<'_>) -> Result<(), Box<dyn std::error::Error + '_>> {
        let labels = self.items.iter().filter(|(label, _)| label.is_some()).count();
        let legend_rows = self.legend_rows();
        let (legend, plot) = area.split_vertically(px(LEGEND_PX * legend_rows as f64));
        if labels > 0 {
            self.draw_legend(&legend)?;
        }
        let (x, y) = self.ranges();
        let font = |size_px: f64| ("sans-serif", size_px * SCALE).into_font();
        let mut chart = ChartBuilder::on(&plot)
            .margin_top(px(6.0))
            .margin_right(px(14.0))
            .x_label_area_size(px(42.0))
            .y_label_area_size(px(62.0))
            .build_cartesian_2d(x.0..x.1, y.0..y.1)?;
        let (x_number, y_format) = (tick_format(x), tick_format(y));
        let x_format = |value: f64| match self.x_names.get(value.round().max(0.0) as usize) {
            Some(name) if (value - value.round()).abs() < 1e-6 => name.clone(),
            _ if self.x_names.is_empty() => x_number(value),
            _ => String::new(),
        };
        let x_ticks =
            if self.x_names.is_empty() { (self.width_px / 75.0) as usize } else { self.x_names.len() };
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(GRID.stroke_width(px(1.0)))
            .axis_style(TEXT.stroke_width(px(1.0)))
            .x_desc(self.x_label.as_str())
            .y_desc(self.y_label.as_str())
            .x_labels(x_ticks)
            .y_labels((self.height_px / 45.0) as usize)
            .x_label_formatter(&|value| x_format(*value))
            .y_label_formatter(&|value| y_format(*value))
            .label_style(font(TEXT_PX - 1.0).color(&TEXT))
            .axis_desc_style(font(TEXT_PX).color(&TEXT))
            .set_all_tick_mark_size(px(4.0))
            .draw()?;
        let inside = chart.plotting_area();
        for (_, item) in &self.items {
            match item {
                Item::Line { points, stroke } => {
                    for piece in points.split(|(x, y)| !(x.is_finite() && y.is_finite())) {
                        inside.draw(&PathElement::new(clip(piece, x, y), style(stroke)))?;
                    }
                }
                Item::Level { y: level, stroke } => {
                    if (y.0..=y.1).contains(level) {
                        inside.draw(&PathElement::new(vec![(x.0, *level), (x.1, *level)], style(stroke)))?;
                    }
                }
                Item::Cells(heat) => {
                    for (corners, colour) in heat.cells() {
                        inside.draw(&Rectangle::new(corners, colour.filled()))?;
                    }
                }
                Item::Points { points, ink, marker, radius_px } => {
                    let within = |p: &&(f64, f64)| (x.0..=x.1).contains(&p.0) && (y.0..=y.1).contains(&p.1);
                    for &point in points.iter().filter(within) {
                        let pixel = inside.map_coordinate(&point);
                        mark(&plot.strip_coord_spec(), pixel, *ink, *marker, *radius_px)?;
                    }
                }
            }
        }
        area.present()?;
        Ok(())
    }

    /// Ranges of both axes.
    fn ranges(&self) -> ((f64, f64), (f64, f64)) {
        let all = || self.items.iter().flat_map(|(_, item)| item.points());
        let x = self.x_range.unwrap_or_else(|| extent(all().map(|p| p.0)));
        let y = self.y_range.unwrap_or_else(|| {
            let (low, high) = extent(all().filter(|p| (x.0..=x.1).contains(&p.0)).map(|p| p.1));
            let margin = 0.05 * (high - low);
            // A quantity that starts at zero keeps its zero line at the bottom.
            (if low == 0.0 { 0.0 } else { low - margin }, high + margin)
        });
        (x, y)
    }

    /// Widths of the legend's entries, px, and the row each one stands in.
    fn legend_layout(&self) -> Vec<(usize, f64)> {
        let (mut row, mut x) = (0, 62.0);
        let mut layout = Vec::new();
        for (label, _) in self.items.iter().filter(|(label, _)| label.is_some()) {
            let width =
                44.0 + label.as_deref().map_or(0, |label| label.chars().count()) as f64 * CHARACTER * TEXT_PX;
            if x + width > self.width_px && x > 62.0 {
                (row, x) = (row + 1, 62.0);
            }
            layout.push((row, x));
            x += width;
        }
        layout
    }

    fn legend_rows(&self) -> usize {
        self.legend_layout().last().map_or(0, |(row, _)| row + 1)
    }

    fn draw_legend(&self, area: &Area<'_>) -> Result<(), Box<dyn std::error::Error + '_>> {
        let text =
            ("sans-serif", TEXT_PX * SCALE).into_font().color(&TEXT).pos(Pos::new(HPos::Left, VPos::Center));
        let labelled =
            self.items.iter().filter_map(|(label, item)| label.as_ref().map(|label| (label, item)));
        for ((label, item), (row, x)) in labelled.zip(self.legend_layout()) {
            let y = pixel(LEGEND_PX * (row as f64 + 0.5));
            let sample = vec![(pixel(x), y), (pixel(x + 26.0), y)];
            match item {
                Item::Line { stroke, .. } | Item::Level { stroke, .. } => {
                    area.draw(&PathElement::new(sample, style(stroke)))?;
                }
                Item::Cells(heat) => {
                    let key = heat.key();
                    for (i, colour) in key.iter().enumerate() {
                        let edge = |i: usize| pixel(x + 26.0 * i as f64 / key.len() as f64);
                        let corners = [(edge(i), y - pixel(5.0)), (edge(i + 1), y + pixel(5.0))];
                        area.draw(&Rectangle::new(corners, colour.filled()))?;
                    }
                }
                Item::Points { ink, marker, radius_px, .. } => {
                    mark(area, (pixel(x + 13.0), y), *ink, *marker, *radius_px)?;
                }
            }
            area.draw(&Text::new(label.as_str(), (pixel(x + 32.0), y), text.clone()))?;
        }
        Ok(())
    }
}

fn px(size: f64) -> u32 {
    (size * SCALE) as u32
}

fn pixel(position: f64) -> i32 {
    (position * SCALE) as i32
}

fn style(stroke: &Stroke) -> ShapeStyle {
    let width = (stroke.width_px * SCALE).max(1.0) as u32;
    ShapeStyle { color: stand_in(stroke.ink, stroke.dash).to_rgba(), filled: false, stroke_width: width }
}

/// Draws one marker at a pixel of an area.
fn mark<'a>(
    area: &Area<'a>,
    (x, y): (i32, i32),
    ink: Ink,
    marker: Marker,
    radius_px: f64,
) -> Result<(), DrawingAreaErrorKind<<SVGBackend<'a> as DrawingBackend>::ErrorType>> {
    let colour = stand_in(ink, Dash::Solid);
    let r = pixel(radius_px);
    let outline = ShapeStyle { color: colour.to_rgba(), filled: false, stroke_width: px(1.8) };
    // Areas inside others draw relative to themselves; the coordinates here are of the whole canvas.
    let (left, top) = area.get_base_pixel();
    let (x, y) = (x - left, y - top);
    match marker {
        Marker::Circle => area.draw(&Circle::new((x, y), r, colour.filled())),
        // A rectangle of the SVG back end has no stroke width, a path has one.
        Marker::Square => {
            let corners =
                [(x - r, y - r), (x + r, y - r), (x + r, y + r), (x - r, y + r), (x - r, y - r - pixel(0.9))];
            area.draw(&PathElement::new(corners.to_vec(), outline))
        }
        Marker::Cross => area.draw(&Cross::new((x, y), r, outline)),
        Marker::Triangle => area.draw(&TriangleMarker::new((x, y), r, colour.filled())),
    }
}

/// Lowest and highest finite value, never equal; (0, 1) of nothing.
fn extent(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let finite = values.filter(|value| value.is_finite());
    let (low, high) =
        finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    if low > high {
        return (0.0, 1.0);
    }
    if high - low < 1e-12 * high.abs().max(1e-300) {
        let half = if high == 0.0 { 1.0 } else { 0.1 * high.abs() };
        return (low - half, high + half);
    }
    (low, high)
}

/// A number in three significant figures.
fn figure(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let decimals = (2.0 - value.abs().log10().floor()).clamp(0.0, 12.0) as usize;
    format!("{value:.decimals$}")
}

/// Decimals that a range of ticks needs.
fn tick_format(range: (f64, f64)) -> impl Fn(f64) -> String {
    let span = (range.1 - range.0).abs();
    let decimals = (2.0 - (span / 2.0).log10().ceil()).clamp(0.0, 9.0) as usize;
    move |value| {
        let text = format!("{value:.decimals$}");
        let trimmed =
            if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
        if trimmed == "-0" { "0".to_owned() } else { trimmed.to_owned() }
    }
}

/// Keeps a line inside the plot: points beyond the range are left out, values above or below it are
/// held at its edge.
fn clip(points: &[(f64, f64)], x: (f64, f64), y: (f64, f64)) -> Vec<(f64, f64)> {
    let inside = points.iter().filter(|p| (x.0..=x.1).contains(&p.0));
    inside.map(|&(px, py)| (px, py.clamp(y.0, y.1))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart() -> Chart {
        let line = (0..100).map(|i| (f64::from(i) * 0.05, (f64::from(i) * 0.1).sin())).collect();
        Chart::new("Frequency f (Hz)", "A_max (m/s2)")
            .line(Some("measured, forward"), Stroke::solid(Ink::Forward).width(2.5), line)
            .line(Some("model"), Stroke::dashed(Ink::Model), vec![(0.0, 0.0), (f64::NAN, 0.0), (4.0, 1.0)])
            .points(Some("Table 2"), Ink::Published, Marker::Square, 5.0, vec![(1.5, 0.5)])
            .level(Some("limit"), Stroke::solid(Ink::Limit), 0.9)
    }

    #[test]
    fn a_chart_names_its_axes_and_series_and_keeps_its_size() {
        let svg = chart().svg().expect("drawn");
        assert!(
            svg.starts_with("<svg width=\"560\" height=\"340\" viewBox=\"0 0 4480 2720\""),
            "{}",
            &svg[..120]
        );
        for text in ["Frequency f (Hz)", "A_max (m/s2)", "measured, forward", "model", "Table 2", "limit"] {
            assert!(svg.contains(text), "{text}");
        }
        assert!(svg.contains("stroke-dasharray") && !svg.contains("#F1"), "stand-ins are gone");
        let page = chart().inline_svg().expect("drawn");
        assert!(page.contains("var(--forward)") && page.contains("var(--grid)"));
    }

    #[test]
    fn an_empty_chart_is_drawn_all_the_same() {
        Chart::new("t (s)", "x (mm)").svg().expect("drawn");
        Chart::new("t (s)", "x (mm)")
            .line(None, Stroke::solid(Ink::Measured), vec![(1.0, 2.0)])
            .svg()
            .expect("one point");
    }

    #[test]
    fn ticks_have_the_decimals_they_need() {
        assert_eq!(tick_format((0.0, 5.0))(0.5), "0.5");
        assert_eq!(tick_format((0.0, 0.02))(0.005), "0.005");
        assert_eq!(tick_format((0.0, 600.0))(200.0), "200");
        assert_eq!(tick_format((-1.0, 1.0))(-0.0), "0");
    }
}
