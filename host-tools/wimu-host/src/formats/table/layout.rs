//! Which columns make which track.

use super::header::Table;
use super::names::{self, Certainty, Kind, Meaning};
use super::presets::{self, Preset};
use super::units::{self, Scale};
use crate::formats::ReadOptions;
use crate::recording::{Origin, Quantity};
use crate::{Code, Problem, Result};

/// Columns of one track.
#[derive(Clone, Debug)]
pub struct Group {
    pub name: String,
    pub quantity: Quantity,
    pub origin: Origin,
    pub sensor: u8,
    /// One for each component.
    pub columns: Vec<usize>,
    /// Unit of each, where it is known.
    pub scales: Vec<Option<Scale>>,
    /// Whether that is what the program writes, and not what the header says.
    pub is_implied: bool,
}

impl Group {
    /// Whether it is an acceleration.
    pub fn is_acceleration(&self) -> bool {
        matches!(self.quantity, Quantity::SpecificForce | Quantity::LinearAcceleration)
    }

    /// Whether its rows count even where they are empty.
    pub fn is_inertial(&self) -> bool {
        self.is_acceleration() || self.quantity == Quantity::AngularRate
    }
}

/// Content of every column of a table.
#[derive(Clone, Debug, Default)]
pub struct Layout {
    /// Column of the time, and the nanoseconds of its unit where it is known.
    pub time: Option<(usize, Option<i64>)>,
    /// Column of the fraction of a time of whole seconds, and the nanoseconds of its unit.
    pub fraction: Option<(usize, i64)>,
    /// Column of the date of a time of day.
    pub date: Option<usize>,
    pub groups: Vec<Group>,
    pub sensitivity: Option<usize>,
    pub gyroscope_scale: Option<usize>,
    /// All other columns.
    pub others: Vec<usize>,
    /// The program that wrote it.
    pub program: Option<&'static str>,
    /// Columns of inertial sensors with a unit that is not known.
    pub unknown_units: Vec<usize>,
}

/// Content of the columns of `table`, in a file of `quantity` by its name.
///
/// # Errors
/// `csv_duplicate_column`, `csv_missing_column`, `csv_mixed_units`, `csv_unknown_unit`, `usage`.
pub fn of(table: &Table, quantity: Option<Quantity>, options: &ReadOptions) -> Result<Layout> {
    let names = &table.names;
    let (meanings, preset) = match &options.columns {
        Some(columns) => (chosen(names, columns)?, None),
        None => {
            let meanings = names.iter().map(|name| names::meaning(name, quantity));
            let mut meanings: Vec<Meaning> = meanings.collect();
            prefer_certain(&mut meanings);
            leave_out_repeated(names, &mut meanings)?;
            (meanings, presets::of_header(names))
        }
    };
    let mut layout = Layout {
        program: table.taken_for.or(preset.map(|preset| preset.name)),
        ..Layout::default()
    };
    choose_time(table, &meanings, preset, &mut layout);
    if layout.time.is_none() && options.columns.is_none() {
        layout.time = less_certain_time(table, &meanings);
    }
    layout.fraction = layout.time.and_then(|(column, _)| fraction(names, column));
    if let (Some((column, None)), Some(_)) = (layout.time, layout.fraction) {
        layout.time = Some((column, Some(units::SECOND)));
    }
    let mut used = vec![false; names.len()];
    for (column, meaning) in meanings.iter().enumerate() {
        match meaning.kind {
            Kind::Component { quantity, origin, sensor, .. } if !used[column] => {
                if let Some(group) = group(names, &meanings, (quantity, origin, sensor), preset)? {
                    group.columns.iter().for_each(|column| used[*column] = true);
                    layout.groups.push(group);
                }
            }
            Kind::Sensitivity => layout.sensitivity = Some(column),
            Kind::GyroscopeScale => layout.gyroscope_scale = Some(column),
            _ => {}
        }
    }
    if let Some(given) = &options.units {
        let [force, rate] = scales(given)?;
        for group in &mut layout.groups {
            let given = if group.is_acceleration() { force } else { rate };
            if let Some(given) = given.filter(|_| group.is_inertial()) {
                group.scales.fill(Some(given));
                group.is_implied = false;
            }
        }
    }
    let quantity_of = |column: usize| {
        meanings[column].kind.quantity().filter(|_| meanings[column].is_unit_unknown)
    };
    let of = |quantity| move |column: &usize| quantity_of(*column) == Some(quantity);
    let force = (0..names.len()).find(of(Quantity::SpecificForce));
    if let Some(column) = force.filter(|_| !layout.groups.iter().any(Group::is_acceleration)) {
        let remedy =
            "write one of LSB, g, mg, m/s² in parentheses, or give --units g (mg, m/s2, LSB)";
        let error = Code::CsvUnknownUnit.error("its unit is unknown", remedy);
        return Err(error.at(&names[column]));
    }
    let is_inertial =
        |column: &usize| of(Quantity::SpecificForce)(column) || of(Quantity::AngularRate)(column);
    layout.unknown_units = (0..names.len()).filter(is_inertial).collect();
    let time = layout.time.map(|(column, _)| column);
    let clock = [time, layout.fraction.map(|(column, _)| column), layout.date];
    layout.others = (0..names.len()).filter(|k| !used[*k] && !clock.contains(&Some(*k))).collect();
    Ok(layout)
}

/// Of the names of a quantity the most certain ones count.
fn prefer_certain(meanings: &mut [Meaning]) {
    let track = |meaning: &Meaning| match meaning.kind {
        Kind::Component { quantity, origin, .. } => Some((quantity, origin)),
        _ => None,
    };
    let all = meanings.to_vec();
    for meaning in meanings {
        let alike = all.iter().filter(|other| track(other) == track(meaning));
        let best = alike.map(|other| other.certainty).min();
        if track(meaning).is_some() && best.is_some_and(|best| best < meaning.certainty) {
            meaning.kind = Kind::Other;
        }
    }
}

/// Of two columns with one meaning the first counts.
fn leave_out_repeated(names: &[String], meanings: &mut [Meaning]) -> Result<()> {
    for column in 1..names.len() {
        let kind = meanings[column].kind;
        let is_same =
            |other: &usize| meanings[*other].kind == kind && !meanings[*other].is_unit_unknown;
        let first = (0..column).find(is_same).filter(|_| is_same(&column));
        let Some(first) = first.filter(|_| !matches!(kind, Kind::Other | Kind::Time)) else {
            continue;
        };
        let [bare, other] = [column, first].map(|column| names::split_unit(&names[column]).0);
        if bare.eq_ignore_ascii_case(other) {
            return Err(Code::CsvDuplicateColumn
                .error(format!("the column `{bare}` occurs twice"), "rename or remove one")
                .at(&names[column]));
        }
        meanings[column].kind = Kind::Other;
    }
    Ok(())
}

fn choose_time(
    Table { names, .. }: &Table,
    meanings: &[Meaning],
    preset: Option<&Preset>,
    layout: &mut Layout,
) {
    let key = |column: &usize| names::key(names::split_unit(&names[*column]).0);
    let of_preset = preset.and_then(|preset| preset.time).and_then(|(name, unit_ns)| {
        let column = (0..names.len()).find(|column| key(column) == name)?;
        Some((column, unit_ns))
    });
    let times = || (0..names.len()).filter(|column| meanings[*column].kind == Kind::Time);
    let time = |column: usize| (column, meanings[column].unit_ns);
    let named = times().find(|column| meanings[*column].unit_ns.is_some());
    layout.time = of_preset.or_else(|| named.or_else(|| times().next()).map(time));
    layout.date = (0..names.len()).find(|k| matches!(key(k).as_str(), "date" | "rtcdate"));
    // `Datum` alone has both.
    let (day, clock): (Vec<usize>, Vec<usize>) = times().partition(|column| key(column) == "datum");
    if let ([day, ..], [clock, ..]) = (&day[..], &clock[..]) {
        (layout.date, layout.time) = (Some(*day), Some(time(*clock)));
    }
}

/// The column of a fraction beside one of seconds: `stamp.nsec` beside `stamp.sec`.
fn fraction(names: &[String], seconds: usize) -> Option<(usize, i64)> {
    const ENDS: [(i64, &[&str]); 3] = [
        (1, &["nanosecs", "nanosec", "nsecs", "nsec", "nanoseconds"]),
        (units::MICROSECOND, &["microsecs", "microsec", "usecs", "usec", "microseconds"]),
        (units::MILLISECOND, &["millisecs", "millisec", "msecs", "msec", "milliseconds"]),
    ];
    let stem = |name: &str, ends: &[&str]| {
        let key = names::key(names::split_unit(name).0);
        ends.iter().find_map(|end| key.strip_suffix(end).map(str::to_owned))
    };
    let of = stem(&names[seconds], &["secs", "sec", "seconds"])?;
    ENDS.into_iter().find_map(|(unit_ns, ends)| {
        let is_part = |name: &String| stem(name, ends).is_some_and(|stem| stem == of);
        Some((names.iter().position(is_part)?, unit_ns))
    })
}

/// An increasing column whose name is a unit of time, or else has the word `time`. Of several units, such as seconds and
/// microseconds, each is only a part of the time.
fn less_certain_time(table: &Table, meanings: &[Meaning]) -> Option<(usize, Option<i64>)> {
    let of = |says: fn(&str) -> bool| {
        let is_free = move |k: &usize| meanings[*k].kind == Kind::Other && says(&table.names[*k]);
        (0..table.names.len()).filter(is_free)
    };
    let increases = |k: &usize| table.increases.get(*k) == Some(&true);
    let mut units = of(names::is_time_unit);
    let unit = units.next().filter(|_| units.next().is_none());
    let column = unit.filter(increases).or_else(|| of(names::mentions_time).find(increases))?;
    Some((column, names::time_unit(&table.names[column])))
}

/// The track of all columns of one sensor; `None` where components are missing.
fn group(
    names: &[String],
    meanings: &[Meaning],
    of: (Quantity, Origin, u8),
    preset: Option<&Preset>,
) -> Result<Option<Group>> {
    let (quantity, origin, sensor) = of;
    let find = |component: usize| {
        let kind = Kind::Component { quantity, origin, sensor, component };
        meanings.iter().position(|meaning| meaning.kind == kind && !meaning.is_unit_unknown)
    };
    let found: Vec<Option<usize>> = (0..quantity.width()).map(find).collect();
    let columns: Vec<usize> = found.iter().flatten().copied().collect();
    if let Some(missing) = found.iter().position(Option::is_none) {
        let is_own = |column: &&usize| meanings[**column].certainty == Certainty::Own;
        let Some(column) = columns.first().filter(is_own).filter(|_| quantity.width() == 3) else {
            return Ok(None);
        };
        let axis = ["X", "Y", "Z"][missing];
        return Err(Code::CsvMissingColumn
            .error(
                format!("`{}` is there, and its axis {axis} is not", names[*column]),
                "all three axes are needed: add it, or rename the others if they are something else",
            )
            .at(&names[*column]));
    }
    let implied = match quantity {
        Quantity::Attitude => Some(Scale::Si(1.0)),
        Quantity::Position | Quantity::Velocity | Quantity::Temperature => None,
        _ => preset.and_then(|preset| preset.scale(quantity)),
    };
    let named: Vec<_> = columns.iter().map(|column| meanings[*column].scale).collect();
    let scales: Vec<_> = named.iter().map(|scale| scale.or(implied)).collect();
    let kind = |scale: &Option<Scale>| scale.map(|scale| std::mem::discriminant(&scale));
    if let Some(k) = (1..scales.len()).find(|k| kind(&scales[*k]) != kind(&scales[0])) {
        return Err(Code::CsvMixedUnits
            .error(
                format!("its unit differs from that of `{}`", names[columns[0]]),
                "convert the columns to one unit",
            )
            .at(&names[columns[k]]));
    }
    Ok(Some(Group {
        name: common_name(names, &columns, quantity),
        quantity,
        origin,
        sensor,
        is_implied: implied.is_some() && named.iter().all(Option::is_none),
        columns,
        scales,
    }))
}

/// What the names of the columns have in common; the quantity where that is nothing.
fn common_name(names: &[String], columns: &[usize], quantity: Quantity) -> String {
    let bare = |column: &usize| names::split_unit(&names[*column]).0;
    if let [only] = columns {
        return bare(only).trim_start_matches(['#', '%']).to_owned();
    }
    let mut name = names[columns[0]].as_str();
    while !columns.iter().all(|column| names[*column].starts_with(name)) {
        name = name.split_at(name.char_indices().last().map_or(0, |(at, _)| at)).0;
    }
    let name = name.trim_end_matches(|c: char| !c.is_alphanumeric());
    let name = name.trim_start_matches(['#', '%']);
    match name.chars().count() {
        0 => quantity.name().to_owned(),
        // `ax, ay, az` says more than `a`.
        1 | 2 => columns.iter().map(bare).collect::<Vec<_>>().join(", "),
        _ => name.to_owned(),
    }
}

/// The units of `g,deg/s`: of acceleration, of angular rate; either may be alone.
fn scales(units: &str) -> Result<[Option<Scale>; 2]> {
    let mut found = [None; 2];
    for unit in units.split(',') {
        let of = |quantity| units::scale(quantity, unit.trim());
        match (of(Quantity::SpecificForce), of(Quantity::AngularRate)) {
            (Some(force), _) => found[0] = Some(force),
            (_, Some(rate)) => found[1] = Some(rate),
            _ => {
                return Err(Code::Usage.error(
                    format!("`{unit}` is not a unit of acceleration or angular rate"),
                    "choose one of m/s2, g, mg, mm/s2, LSB, and of rad/s, deg/s: --units g,deg/s",
                ));
            }
        }
    }
    Ok(found)
}

/// SI of [`units`](ReadOptions::units) of a log: of acceleration, and of angular rate.
///
/// # Errors
/// `usage`.
pub fn si_of(units: &str) -> Result<[f64; 2]> {
    let factor = |scale: Option<Scale>| match scale {
        None => Ok(1.0),
        Some(Scale::Si(factor)) => Ok(factor),
        Some(_) => Err(Code::Usage
            .error("a log has no counts", "give --units in m/s2, g or mg, and rad/s or deg/s")),
    };
    let [force, rate] = scales(units)?;
    Ok([factor(force)?, factor(rate)?])
}

/// Wrong use of `--columns`.
fn columns_usage(message: String) -> Problem {
    Code::Usage.error(
        message,
        "write for example --columns \"t=timestamp:ns,x=ax:g,y=ay:g,z=az:g,gx=4:deg/s\"; a column is its name, or its number from 1",
    )
}

/// Meaning of the columns by [`ReadOptions::columns`].
fn chosen(names: &[String], columns: &str) -> Result<Vec<Meaning>> {
    let mut meanings = vec![Meaning::OTHER; names.len()];
    for part in columns.split(',') {
        let (role, column) = part
            .split_once('=')
            .ok_or_else(|| columns_usage(format!("`{part}` is not ROLE=COLUMN")))?;
        let kind = role_of(role.trim()).ok_or_else(|| {
            columns_usage(format!(
                "`{role}` is not a role: t, x, y, z, gx, gy, gz, mx, my, mz, temp"
            ))
        })?;
        let column = column.trim();
        let (name, unit) = match column.rsplit_once(':') {
            Some((name, unit)) if find_column(names, column).is_none() => {
                (name.trim(), Some(unit.trim()))
            }
            _ => (column, None),
        };
        let index = find_column(names, name).ok_or_else(|| {
            let named: Vec<_> = names.iter().take(30).map(String::as_str).collect();
            Code::CsvMissingColumn.error(
                format!("there is no column `{name}`"),
                format!("choose from: {}", named.join(", ")),
            )
        })?;
        // A unit in the header is the default.
        let mut meaning = names::meaning(&names[index], None);
        if std::mem::discriminant(&meaning.kind) != std::mem::discriminant(&kind) {
            meaning = Meaning::OTHER;
        }
        (meaning.kind, meaning.certainty) = (kind, Certainty::Own);
        meaning.is_unit_unknown = false;
        if unit.is_some_and(|unit| !meaning.take_unit(unit)) {
            let unit = unit.unwrap_or_default();
            return Err(columns_usage(format!("the unit `{unit}` of `{role}` is not known")));
        }
        meanings[index] = meaning;
    }
    Ok(meanings)
}

pub fn find_column(names: &[String], name: &str) -> Option<usize> {
    let is_bare = |column: &String| names::split_unit(column).0.eq_ignore_ascii_case(name);
    let by_name = names.iter().position(|column| column.eq_ignore_ascii_case(name));
    let by_bare = || names.iter().position(is_bare);
    let number = || name.parse::<usize>().ok()?.checked_sub(1);
    by_name.or_else(by_bare).or_else(|| number().filter(|column| *column < names.len()))
}

fn role_of(role: &str) -> Option<Kind> {
    let (quantity, axis) = match role {
        "t" => return Some(Kind::Time),
        "temp" => (Quantity::Temperature, "x"),
        "x" | "y" | "z" => (Quantity::SpecificForce, role),
        "gx" | "gy" | "gz" => (Quantity::AngularRate, &role[1..]),
        "mx" | "my" | "mz" => (Quantity::MagneticField, &role[1..]),
        _ => return None,
    };
    let component = "xyz".find(axis)?;
    Some(Kind::Component { quantity, origin: Origin::Sensor, sensor: 0, component })
}
