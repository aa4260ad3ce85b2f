//! Counts with singular and plural.

/// `1 gap`, `2 gaps`, `3 passes`.
pub fn counted(count: usize, one: &str) -> String {
    let end = match (count, one.ends_with(['s', 'x'])) {
        (1, _) => "",
        (_, true) => "es",
        (_, false) => "s",
    };
    format!("{count} {one}{end}")
}
