//! A table of text cells, for a terminal and for a page.

use super::page::escape;
use std::fmt::Write as _;

/// A table; the first column reads from the left, the others from the right.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    head: Vec<String>,
    rows: Vec<Vec<String>>,
    /// Cells hold sentences: on a page they wrap and read from the left.
    sentences: bool,
}

impl Table {
    /// A table with these column heads (units included).
    pub fn new<S: Into<String>>(head: impl IntoIterator<Item = S>) -> Self {
        Self { head: head.into_iter().map(Into::into).collect(), rows: Vec::new(), sentences: false }
    }

    /// A table whose cells hold sentences: on a page they wrap and read from the left.
    pub fn of_sentences<S: Into<String>>(head: impl IntoIterator<Item = S>) -> Self {
        Self { sentences: true, ..Self::new(head) }
    }

    /// The table with one more row; missing cells stay empty.
    #[must_use]
    pub fn row<S: Into<String>>(mut self, cells: impl IntoIterator<Item = S>) -> Self {
        self.push(cells);
        self
    }

    /// Adds a row; missing cells stay empty.
    pub fn push<S: Into<String>>(&mut self, cells: impl IntoIterator<Item = S>) {
        self.rows.push(cells.into_iter().map(Into::into).collect());
    }

    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// The table as lines of text in aligned columns.
    pub fn text(&self) -> String {
        let columns = self.rows.iter().map(Vec::len).fold(self.head.len(), usize::max);
        let cell = |row: &[String], i: usize| row.get(i).cloned().unwrap_or_default();
        let width = |i: usize| {
            let all = self.rows.iter().chain(std::iter::once(&self.head));
            all.map(|row| cell(row, i).chars().count()).max().unwrap_or(0)
        };
        let widths: Vec<usize> = (0..columns).map(width).collect();
        let mut out = String::new();
        let mut line = |row: &[String]| {
            let mut text = String::new();
            for (i, &width) in widths.iter().enumerate() {
                // Writing to a String cannot fail.
                let _ = match i {
                    0 => write!(text, "{:<width$}", cell(row, i)),
                    _ => write!(text, "  {:>width$}", cell(row, i)),
                };
            }
            out.push_str(text.trim_end());
            out.push('\n');
        };
        if self.head.iter().any(|head| !head.is_empty()) {
            line(&self.head);
            let rules: Vec<String> = widths.iter().map(|&width| "-".repeat(width)).collect();
            line(&rules);
        }
        self.rows.iter().for_each(|row| line(row));
        out
    }

    /// The table as HTML.
    pub fn html(&self) -> String {
        let cells = |row: &[String], tag: &str| -> String {
            row.iter().map(|cell| format!("<{tag}>{}</{tag}>", escape(cell))).collect()
        };
        let class = if self.sentences { " class=\"sentences\"" } else { "" };
        let mut out = format!("<div class=\"scroll\"><table{class}>");
        if self.head.iter().any(|head| !head.is_empty()) {
            let _ = write!(out, "<thead><tr>{}</tr></thead>", cells(&self.head, "th"));
        }
        out.push_str("<tbody>");
        for row in &self.rows {
            let _ = write!(out, "<tr>{}</tr>", cells(row, "td"));
        }
        out.push_str("</tbody></table></div>\n");
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_aligned_and_html_is_escaped() {
        let table = Table::new(["", "A_max (m/s2)"]).row(["measured", "2.94"]).row(["<model>"]);
        assert_eq!(
            table.text(),
            "          A_max (m/s2)\n--------  ------------\nmeasured          2.94\n<model>\n"
        );
        assert!(table.html().contains("<td>&lt;model&gt;</td>"));
    }
}
