//! Tables that tests write into `docs/safety.md`, between two marks of their name.

use std::path::PathBuf;

pub fn page() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("docs/safety.md")
}

fn marks(name: &str) -> (String, String) {
    (format!("<!-- {name}: written by the tests -->\n"), format!("<!-- end of {name} -->"))
}

/// The text between the marks.
pub fn section(name: &str) -> String {
    let text = std::fs::read_to_string(page()).expect("docs/safety.md");
    let (begin, end) = marks(name);
    let from = text.find(&begin).expect("the first mark") + begin.len();
    let to = text[from..].find(&end).expect("the second mark") + from;
    text[from..to].to_owned()
}

/// Replaces the text between the marks.
pub fn write_section(name: &str, body: &str) {
    let text = std::fs::read_to_string(page()).expect("docs/safety.md");
    let (begin, end) = marks(name);
    let from = text.find(&begin).expect("the first mark") + begin.len();
    let to = text[from..].find(&end).expect("the second mark") + from;
    let new = format!("{}\n{}\n\n{}", &text[..from], body.trim_end(), &text[to..]);
    std::fs::write(page(), new).expect("written");
}
