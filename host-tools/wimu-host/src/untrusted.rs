//! Text from files, boards and networks in messages to people.

use std::borrow::Cow;
use std::path::Path;

/// Whether a terminal acts on a character, or it reorders or breaks the text around it: controls (C0, DEL and C1), line
/// and paragraph separators, and the bidirectional controls of Unicode Standard Annex 9.
pub fn is_active(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

/// One line of a message: active characters, line breaks included, are written as in a Rust string, such as `\u{1b}`.
///
/// ```
/// use wimu_host::untrusted::printable;
///
/// assert_eq!(printable("±2 g"), "±2 g");
/// assert_eq!(printable("a\n\x1b[2J\u{202e}"), r"a\n\u{1b}[2J\u{202e}");
/// ```
pub fn printable(text: &str) -> Cow<'_, str> {
    escaped(text, is_active, |c| c.escape_default().to_string())
}

/// Name of a file in messages.
pub fn name(path: &Path) -> String {
    printable(&path.display().to_string()).into_owned()
}

/// Text with the characters that `must` be escaped replaced.
pub fn escaped(
    text: &str,
    must: impl Fn(char) -> bool,
    escape: impl Fn(char) -> String,
) -> Cow<'_, str> {
    if !text.contains(&must) {
        return text.into();
    }
    let one = |c| if must(c) { escape(c) } else { String::from(c) };
    text.chars().map(one).collect::<String>().into()
}
