//! Arguments of the studies: words that each have a value.

use std::error::Error;
use std::ops::Range;

/// Gives every word with its value to `take`, which says whether it knows the word.
///
/// # Errors
/// A word without a value, one that is not known, and what `take` fails by.
pub fn each(
    mut words: impl Iterator<Item = String>,
    mut take: impl FnMut(&str, String) -> Result<bool, Box<dyn Error>>,
) -> Result<(), Box<dyn Error>> {
    while let Some(word) = words.next() {
        let value = words.next().ok_or_else(|| format!("{word}: a value is missing"))?;
        if !take(&word, value)? {
            return Err(format!("unknown argument {word}").into());
        }
    }
    Ok(())
}

/// Seeds as in `1000..1040`.
///
/// # Errors
/// Not two numbers with two dots between them.
pub fn seeds(value: &str) -> Result<Range<u64>, Box<dyn Error>> {
    let (from, to) = value.split_once("..").ok_or("--seeds FROM..TO")?;
    Ok(from.parse()?..to.parse()?)
}
