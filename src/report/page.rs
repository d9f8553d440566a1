//! A self-contained HTML page of sections, figures and tables: no scripts, nothing fetched.

use super::ReportError;
use super::chart::Chart;
use super::style::style_sheet;
use super::table::Table;
use std::fmt::Write as _;
use std::path::Path;

const LAYOUT: &str = "body{font:15px/1.5 system-ui,sans-serif;color:var(--ink);background:Canvas;max-width:1180px;\
margin:0 auto;padding:1.2rem 1.4rem 4rem}h1{font-size:1.55rem;margin:.6rem 0 .2rem}h2{font-size:1.15rem;\
margin:2.2rem 0 .5rem;border-bottom:1px solid var(--grid);padding-bottom:.2rem}p{max-width:80ch;margin:.4rem 0}\
figure{margin:.6rem 0;break-inside:avoid}figcaption{font-size:.88rem;opacity:.85;max-width:100ch}\
svg{max-width:100%;height:auto;display:block}.grid{display:grid;gap:.4rem 1.2rem;\
grid-template-columns:repeat(auto-fit,minmax(min(100%,460px),1fr))}.scroll{overflow-x:auto}\
table{border-collapse:collapse;font-variant-numeric:tabular-nums;margin:.6rem 0}\
th,td{padding:.22rem .8rem;text-align:right;border-bottom:1px solid var(--grid);white-space:nowrap}\
th:first-child,td:first-child{text-align:left;padding-left:0}th{font-weight:600}\
.sentences td,.sentences th{text-align:left;vertical-align:top}.sentences td:last-child{white-space:normal;max-width:80ch}\
.note{border-left:3px solid var(--model);padding:.2rem .8rem;margin:.8rem 0}\
details{margin:.6rem 0}summary{cursor:pointer}pre{overflow-x:auto;font-size:.85rem}";

/// A page under construction; parts appear in the order of the calls.
#[derive(Clone, Debug)]
pub struct Page {
    title: String,
    body: String,
}

/// Text made safe for HTML.
pub(super) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

impl Page {
    /// A page with its title as first heading.
    pub fn new(title: &str) -> Self {
        Self { title: title.to_owned(), body: format!("<h1>{}</h1>\n", escape(title)) }
    }

    /// Starts a section.
    pub fn section(&mut self, heading: &str) {
        self.add(format_args!("<h2>{}</h2>\n", escape(heading)));
    }

    /// Adds a paragraph of plain text.
    pub fn text(&mut self, text: &str) {
        self.add(format_args!("<p>{}</p>\n", escape(text)));
    }

    /// Adds a paragraph that stands out: something the reader must not miss.
    pub fn note(&mut self, text: &str) {
        self.add(format_args!("<p class=\"note\">{}</p>\n", escape(text)));
    }

    /// Adds a table.
    pub fn table(&mut self, table: &Table) {
        self.body.push_str(&table.html());
    }

    /// Adds a table that is folded away under its summary until it is asked for.
    pub fn folded_table(&mut self, summary: &str, table: &Table) {
        self.add(format_args!("<details><summary>{}</summary>{}</details>\n", escape(summary), table.html()));
    }

    /// Adds preformatted text that is folded away under its summary until it is asked for.
    pub fn folded_text(&mut self, summary: &str, text: &str) {
        let (summary, text) = (escape(summary), escape(text));
        self.add(format_args!("<details><summary>{summary}</summary><pre>{text}</pre></details>\n"));
    }

    /// Adds one figure over the whole width.
    ///
    /// # Errors
    /// [`ReportError::Figure`] when the figure cannot be drawn.
    pub fn figure(&mut self, chart: &Chart, caption: &str) -> Result<(), ReportError> {
        self.figures(&[(chart, caption)])
    }

    /// Adds figures side by side, each with its caption.
    ///
    /// # Errors
    /// [`ReportError::Figure`] when one cannot be drawn.
    pub fn figures(&mut self, figures: &[(&Chart, &str)]) -> Result<(), ReportError> {
        self.body.push_str(if figures.len() > 1 { "<div class=\"grid\">\n" } else { "" });
        for (chart, caption) in figures {
            let svg = chart.inline_svg()?;
            self.add(format_args!("<figure>{svg}<figcaption>{}</figcaption></figure>\n", escape(caption)));
        }
        self.body.push_str(if figures.len() > 1 { "</div>\n" } else { "" });
        Ok(())
    }

    /// Adds a drawing that is SVG already, over the whole width.
    pub fn drawing(&mut self, svg: &str, caption: &str) {
        self.add(format_args!(
            "<figure class=\"scroll\">{svg}<figcaption>{}</figcaption></figure>\n",
            escape(caption)
        ));
    }

    /// The whole page.
    pub fn html(&self) -> String {
        format!(
            "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
             <meta name=\"viewport\" content=\"width=device-width\"><title>{}</title>\
             <style>{}{LAYOUT}</style></head>\n<body>\n{}</body></html>\n",
            escape(&self.title),
            style_sheet(),
            self.body
        )
    }

    /// Writes the page to a file, whole or not at all.
    ///
    /// # Errors
    /// [`ReportError::Write`] with the path.
    pub fn write(&self, path: &Path) -> Result<(), ReportError> {
        let error = |source| ReportError::Write { path: path.to_owned(), source };
        let partial = path.with_extension("html.partial");
        std::fs::write(&partial, self.html()).map_err(error)?;
        std::fs::rename(&partial, path).map_err(error)
    }

    fn add(&mut self, parts: std::fmt::Arguments<'_>) {
        // Writing to a String cannot fail.
        let _ = self.body.write_fmt(parts);
    }
}
