//! Where the table is in a text: separator, column names, first row.

use std::borrow::Cow;

use super::names::{self, Kind};
use super::presets;
use super::text::{Lines, field, is_comment, is_text, split};
use super::times;
use super::units;
use crate::formats::Source;
use crate::recording::Quantity;
use crate::{Code, Result};

/// The table begins within this many lines and bytes.
const MAX_LINES: usize = 200;
const MAX_BYTES: usize = 1 << 18;
/// Rows of equal width that show a table without a header.
const ROWS: usize = 3;
/// Known columns that show a header whatever its width.
const KNOWN: usize = 3;
/// In the order in which they are preferred. A space stands for any white space.
pub const SEPARATORS: [char; 5] = [';', '\t', ',', '|', ' '];

/// A table in a text.
#[derive(Clone, Debug)]
pub struct Table {
    pub separator: char,
    /// Whether the decimal mark is a comma.
    pub comma: bool,
    /// Names of the columns; without a header, their numbers from 1.
    pub names: Vec<String>,
    /// Line of the column names; of the first row without a header.
    pub line: u64,
    /// Line of the first row.
    pub first_row: u64,
    /// Lines before the table.
    pub preamble: Vec<String>,
    /// What a table without a header was taken for.
    pub taken_for: Option<&'static str>,
    /// Whether each column only increases in the first rows.
    pub increases: Vec<bool>,
}

/// Lines at the beginning of a text.
fn beginning(source: &Source) -> Result<Vec<String>> {
    let mut lines = Lines::of(source)?;
    let (mut start, mut bytes) = (Vec::new(), 0);
    while start.len() < MAX_LINES && bytes < MAX_BYTES {
        let Some(line) = lines.next_line()? else {
            break;
        };
        bytes += line.len();
        start.push(line.into_owned());
    }
    Ok(start)
}

/// The table in a text whose name says that it is of `quantity`.
///
/// # Errors
/// `csv_empty`, `no_rows`, `csv_no_header`.
pub fn find(source: &Source, quantity: Option<Quantity>) -> Result<Table> {
    let start = beginning(source)?;
    if start.iter().all(|line| line.trim().is_empty()) {
        let error = Code::CsvEmpty
            .error("the file is empty", "a table starts with a line of column names and units");
        return Err(error.at(source.name()));
    }
    // The first separator of equal ones is preferred.
    let tables = SEPARATORS.iter().rev();
    let tables = tables.filter_map(|separator| table(&start, *separator, quantity));
    if let Some((_, table)) = tables.max_by_key(|(score, _)| *score) {
        return Ok(table);
    }
    let is_header = |line: &String| {
        let known = |separator: &char| known(&names_of(line, *separator), quantity);
        SEPARATORS.iter().any(|separator| known(separator) >= KNOWN)
    };
    Err(if start.iter().any(is_header) {
Code::NoRows.error(
            "there are no rows below the header",
            "check that the recording was saved completely",
        )
} else {
Code::CsvNoHeader.error(
            "there is no table of numbers in the text",
            "a table starts with column names, such as `Time (s),Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g)`",
        )
}
    .at(source.name()))
}

/// The table with this separator, and how well it fits: known columns, numbers in its first row.
fn table(
    start: &[String],
    separator: char,
    quantity: Option<Quantity>,
) -> Option<((usize, usize), Table)> {
    let first = start.iter().position(|line| numbers(line, separator) >= 2)?;
    let fields = split(&start[first], separator);
    let width = fields.len();
    let rows = &start[first..];
    let has_mark = |mark: char| {
        let is_marked = |f: &Cow<str>| f.contains(mark) && !is_text(f, mark == ',');
        (rows.iter()).any(|line| split(line, separator).iter().any(is_marked))
    };
    let has_point = has_mark('.');
    let header = start[..first].iter().enumerate().filter_map(|(at, line)| {
        let names = names_of(line, separator);
        let known = known(&names, quantity);
        let fits = (width.saturating_sub(1)..=width).contains(&names.len()) && names.len() > 1;
        // Rows whose decimal commas are separators as well: refused later.
        let is_split = separator == ','
            && at + 1 == first
            && names.len() >= 3
            && splits_decimals(width, names.len())
            && !has_point;
        let is_header = (fits || is_split) && numbers(line, separator) < 2 || known >= KNOWN;
        is_header.then_some((known, at, names))
    });
    let header = header.max_by_key(|(known, at, _)| (*known, *at));
    // Between commas, decimal commas are in quoted fields.
    let comma = !has_point && has_mark(',');
    let mut table = Table {
        separator,
        comma,
        names: (1..=width).map(|number| number.to_string()).collect(),
        line: first as u64 + 1,
        first_row: first as u64 + 1,
        preamble: start[..first].to_vec(),
        taken_for: None,
        increases: Vec::new(),
    };
    let score = numbers(&start[first], separator);
    let Some((known, at, names)) = header else {
        let is_text = |f: &Cow<str>| is_text(f, true) && times::date(None, f).is_none();
        let texts: Vec<bool> = fields.iter().map(is_text).collect();
        // Three numbers or more, and the same columns of text in each row.
        let alike = rows.iter().take(ROWS).all(|line| {
            let fields = split(line, separator);
            numbers(line, separator) >= 3 && fields.iter().map(is_text).eq(texts.iter().copied())
        });
        table.increases = increases(rows, &table);
        if let Some((names, taken_for)) = presets::without_header(&table.increases, &texts) {
            table.names = names;
            table.taken_for = Some(taken_for);
        }
        return (alike && width >= 3).then_some(((0, score), table));
    };
    table.names = names;
    if let Some(above) = at.checked_sub(1).and_then(|above| start.get(above)) {
        prepend_groups(&mut table.names, above, separator);
    }
    if let Some(units) = start.get(at + 1).filter(|_| at + 1 < first) {
        append_units(&mut table.names, units, separator);
    }
    table.increases = increases(rows, &table);
    table.line = at as u64 + 1;
    table.preamble = start[..at].to_vec();
    Some(((known, score), table))
}

/// Whether each column of the rows only increases.
fn increases(rows: &[String], table: &Table) -> Vec<bool> {
    let number = |text: Option<&Cow<str>>| {
        let number = field(text?, table.comma).filter(|value| value.is_finite());
        number.or_else(|| times::date(None, text?).map(|ns| ns as f64))
    };
    let rows: Vec<_> = (rows.iter().map(|line| split(line, table.separator))).collect();
    let increases = |column: usize| {
        let steps = rows.windows(2).filter_map(|pair| {
            let [before, after] = [&pair[0], &pair[1]].map(|row| number(row.get(column)));
            Some(after? - before?)
        });
        let steps: Vec<f64> = steps.collect();
        !steps.is_empty()
            && steps.iter().all(|step| *step >= 0.0)
            && steps.iter().any(|step| *step > 0.0)
    };
    (0..table.names.len()).map(increases).collect()
}

/// Whether rows of `fields` below a header of `names` columns look like numbers with decimal commas between commas.
pub fn splits_decimals(fields: usize, names: usize) -> bool {
    (3 * names / 2 + 1..=2 * names).contains(&fields)
}

/// Number of numbers and dates of a row; 0 if they are not most of its fields.
fn numbers(line: &str, separator: char) -> usize {
    if is_comment(line) {
        return 0;
    }
    let fields = split(line, separator);
    let filled = fields.iter().filter(|f| !f.is_empty());
    let is_number = |text: &&Cow<str>| !is_text(text, true) || times::date(None, text).is_some();
    let (filled, numbers) = (filled.clone().count(), filled.filter(is_number).count());
    if 2 * numbers > filled { numbers } else { 0 }
}

/// Column names in a line, which may be a comment.
fn names_of(line: &str, separator: char) -> Vec<String> {
    let bare = line.trim_start_matches("//").trim_start_matches(['#', '%', ' ']);
    let names = split(bare, separator).into_iter().map(String::from);
    let mut names: Vec<String> = names.collect();
    while names.pop_if(|name| name.is_empty()).is_some() {}
    names
}

/// Number of columns whose meaning is known.
fn known(names: &[String], quantity: Option<Quantity>) -> usize {
    let meanings = names.iter().map(|name| names::meaning(name, quantity).kind);
    meanings.filter(|kind| *kind != Kind::Other).count()
}

/// Prepends the names of groups of a line above, `IMU Acceleration;;;`, if the names are letters or units only.
fn prepend_groups(names: &mut [String], line: &str, separator: char) {
    let above = split(line, separator);
    let is_short = |name: &String| name.chars().count() < 2 || is_unit(name);
    if !names.iter().all(is_short) || names_of(line, separator).len() < 2 {
        return;
    }
    let mut group = "";
    for (column, name) in names.iter_mut().enumerate() {
        match above.get(column) {
            Some(text) if !text.is_empty() => group = text,
            _ => {}
        }
        // `Accelerometer [g]` above `X` is `Accelerometer X [g]`.
        let (bare, unit) = names::split_unit(group);
        let unit = unit.map(|unit| format!(" [{unit}]")).unwrap_or_default();
        *name = format!("{bare} {name}{unit}").trim().to_owned();
    }
}

/// Whether a text is a unit, in brackets or not, of what a sensor measures.
fn is_unit(text: &str) -> bool {
    use Quantity::{AngularRate, MagneticField, SpecificForce, Temperature};
    let bare = bare_unit(text);
    let of = |quantity: Quantity| units::scale(quantity, bare).is_some();
    units::time(bare).is_some()
        || [SpecificForce, AngularRate, MagneticField, Temperature].into_iter().any(of)
}

fn bare_unit(text: &str) -> &str {
    let within = |open, close| text.strip_prefix(open)?.strip_suffix(close);
    within('(', ')').or_else(|| within('[', ']')).unwrap_or(text)
}

/// Appends the units of a line below the names, if it holds units only.
fn append_units(names: &mut [String], line: &str, separator: char) {
    let found = split(line, separator);
    let are_units = found.iter().all(|f| f.is_empty() || is_unit(f));
    if found.len() != names.len() || found.iter().all(|f| f.is_empty()) || !are_units {
        return;
    }
    for (name, unit) in names.iter_mut().zip(found).filter(|(_, unit)| !unit.is_empty()) {
        *name = format!("{name} ({})", bare_unit(&unit).replace(['(', ')'], ""));
    }
}
