//! Screens for terminals without UTF-8.

use ratatui::buffer::Buffer;

/// Whether the locale of these environment variables has UTF-8. Without any it is the C locale, except on Windows.
pub fn is_utf8(variable: impl Fn(&str) -> Option<String>) -> bool {
    let given = ["LC_ALL", "LC_CTYPE", "LANG"].into_iter().filter_map(variable);
    let locale = given.into_iter().find(|value| !value.is_empty());
    let named = |locale: String| locale.to_lowercase().replace('-', "").contains("utf8");
    locale.map_or(cfg!(windows), named)
}

/// Replaces every character beyond ASCII.
pub fn convert(buffer: &mut Buffer) {
    for index in 0..buffer.content.len() {
        let symbol = buffer.content[index].symbol();
        if symbol.is_ascii() {
            continue;
        }
        let is_blank = |at: Option<usize>| {
            at.and_then(|at| buffer.content.get(at)).is_some_and(|cell| cell.symbol() == " ")
        };
        let first = symbol.chars().next().unwrap_or(' ');
        // It has blanks on both sides.
        if first == '±' && is_blank(index.checked_sub(1)) && is_blank(Some(index + 1)) {
            for (at, symbol) in ["+", "/", "-"].into_iter().enumerate() {
                buffer.content[index - 1 + at].set_symbol(symbol);
            }
            continue;
        }
        let mut bytes = [0; 4];
        buffer.content[index].set_symbol(like(first).encode_utf8(&mut bytes));
    }
}

/// The ASCII character that resembles `c` most.
fn like(c: char) -> char {
    // Braille patterns have a bit for each dot.
    if let Some(dots) = (c as u32).checked_sub(0x2800).filter(|dots| *dots < 256) {
        return [' ', '.', ':', '*', '#'][(dots.count_ones() as usize).div_ceil(2)];
    }
    match c {
        '▁' => '_',
        '▂' => '.',
        '▃' => '-',
        '▄' => '=',
        '▅' => '+',
        '▆' => '*',
        '▏' | '▎' | '▍' => ' ',
        '▇' | '█' | '▌' | '▋' | '▊' | '▉' => '#',
        '│' | '┃' => '|',
        '─' | '━' | '−' | '–' => '-',
        '┌' | '┐' | '└' | '┘' | '╭' | '╮' | '╰' | '╯' => '+',
        '²' => '2',
        'µ' | 'μ' => 'u',
        '±' => '~',
        '↑' => '^',
        '↓' => 'v',
        '…' => '.',
        '·' => '.',
        '•' | '●' => 'o',
        '°' => ' ',
        _ => '?',
    }
}
