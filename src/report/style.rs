//! Colours and strokes of figures: named by their role, so that a page can show them on a light or a
//! dark ground, and drawn through stand-in colours that the plotting library passes on unchanged.

use plotters::style::RGBColor;

/// What a colour stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ink {
    /// Forward sweep: red.
    Forward,
    /// Backward sweep: blue.
    Backward,
    /// What was measured: dark (light on a dark ground).
    Measured,
    /// What a model gives: orange.
    Model,
    /// What a publication states: green.
    Published,
    /// A limit: violet.
    Limit,
    /// One of six further colours (0 to 5), for anything else.
    Other(u8),
}

/// Line pattern.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Dash {
    /// Unbroken.
    #[default]
    Solid,
    /// Dashes.
    Dashed,
    /// Dots.
    Dotted,
}

/// How a line is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stroke {
    /// Colour by role.
    pub ink: Ink,
    /// Width, px.
    pub width_px: f64,
    /// Pattern.
    pub dash: Dash,
}

impl Stroke {
    /// An unbroken line 1.5 px wide.
    pub fn solid(ink: Ink) -> Self {
        Self { ink, width_px: 1.5, dash: Dash::Solid }
    }

    /// A dashed line 1.5 px wide.
    pub fn dashed(ink: Ink) -> Self {
        Self { dash: Dash::Dashed, ..Self::solid(ink) }
    }

    /// The same line in another width, px.
    #[must_use]
    pub fn width(self, width_px: f64) -> Self {
        Self { width_px, ..self }
    }
}

/// Name of the style sheet's variable, colour on a light ground, colour on a dark ground.
type Tint = (&'static str, &'static str, &'static str);

/// Text and axes, grid; then the inks.
const TINTS: [Tint; 14] = [
    ("ink", "#24292f", "#e6e6e6"),
    ("grid", "#d5d9de", "#3d434b"),
    ("forward", "#c62828", "#ff6b5e"),
    ("backward", "#1557b0", "#6fb1ff"),
    ("measured", "#24292f", "#f0f0f0"),
    ("model", "#d9700d", "#ffa94d"),
    ("published", "#1a7f37", "#5bd47b"),
    ("limit", "#8a3ab9", "#cf94f5"),
    ("other0", "#00798c", "#4dd0e1"),
    ("other1", "#b0307a", "#f48fb1"),
    ("other2", "#6b6f00", "#d4d94f"),
    ("other3", "#4f46c4", "#a5a0ff"),
    ("other4", "#8d5524", "#d7a77b"),
    ("other5", "#5a6572", "#aab4bf"),
];

/// Place of an ink in [`TINTS`].
fn tint(ink: Ink) -> usize {
    match ink {
        Ink::Forward => 2,
        Ink::Backward => 3,
        Ink::Measured => 4,
        Ink::Model => 5,
        Ink::Published => 6,
        Ink::Limit => 7,
        Ink::Other(i) => 8 + usize::from(i % 6),
    }
}

/// Stand-in of text and axes.
pub(super) const TEXT: RGBColor = RGBColor(0xF1, 0x00, 0x00);
/// Stand-in of the grid.
pub(super) const GRID: RGBColor = RGBColor(0xF1, 0x01, 0x00);

/// Stand-in of a stroke: which tint and which pattern, as a colour that stands for nothing else.
pub(super) fn stand_in(ink: Ink, dash: Dash) -> RGBColor {
    RGBColor(0xF1, tint(ink) as u8, dash as u8)
}

/// Puts the true colours and patterns in place of the stand-ins: fixed ones for a file that stands
/// alone, variables of the page's style sheet for one that is part of a page.
pub(super) fn resolve(svg: &str, in_page: bool, scale: f64) -> String {
    let mut out = String::with_capacity(svg.len() + svg.len() / 8);
    let mut rest = svg;
    while let Some(at) = rest.find("\"#F1") {
        let (before, found) = rest.split_at(at);
        out.push_str(before);
        let code = |range| found.get(range).and_then(|hex| usize::from_str_radix(hex, 16).ok());
        let known = code(4..6).and_then(|i| TINTS.get(i)).zip(code(6..8));
        let Some(((name, light, _), dash)) = known.filter(|_| found.as_bytes().get(8) == Some(&b'"')) else {
            out.push_str(&found[..1]);
            rest = &found[1..];
            continue;
        };
        if in_page {
            out.push_str(&format!("\"var(--{name})\""));
        } else {
            out.push_str(&format!("\"{light}\""));
        }
        match dash {
            1 => out.push_str(&format!(" stroke-dasharray=\"{} {}\"", 6.0 * scale, 4.0 * scale)),
            2 => out.push_str(&format!(" stroke-dasharray=\"{} {}\"", 1.5 * scale, 3.0 * scale)),
            _ => {}
        }
        rest = &found[9..];
    }
    out.push_str(rest);
    out
}

/// The variables of the inks, for light and dark grounds.
pub(super) fn style_sheet() -> String {
    let block = |dark: bool| -> String {
        TINTS.iter().map(|(name, l, d)| format!("--{name}:{};", if dark { d } else { l })).collect()
    };
    format!(
        ":root{{color-scheme:light dark;{}}}@media (prefers-color-scheme:dark){{:root{{{}}}}}",
        block(false),
        block(true)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stand_ins_are_replaced_by_colour_and_pattern() {
        let RGBColor(r, g, b) = stand_in(Ink::Model, Dash::Dashed);
        let svg =
            format!("<line stroke=\"#{r:02X}{g:02X}{b:02X}\"/><text fill=\"#F10000\"/><p id=\"#F1zz\"/>");
        assert_eq!(
            resolve(&svg, false, 1.0),
            "<line stroke=\"#d9700d\" stroke-dasharray=\"6 4\"/><text fill=\"#24292f\"/><p id=\"#F1zz\"/>"
        );
        assert!(resolve(&svg, true, 1.0).starts_with("<line stroke=\"var(--model)\""));
        assert!(style_sheet().contains("--model:#ffa94d"));
    }
}
