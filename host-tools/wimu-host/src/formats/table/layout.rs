//! Which columns make which track.

use super::header::Table;
use super::names::{self, Kind, Meaning};
use super::presets::{self, Preset};
use super::units::{self, Scale};
use crate::formats::ReadOptions;
use crate::recording::{Origin, Quantity};
use crate::{Code, Result};

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
    /// Column of the time, and its unit where it is known.
    pub time: Option<(usize, Option<i32>)>,
    /// Column of the fraction of a time of whole seconds, and the power of ten of a nanosecond of its unit.
    pub fraction: Option<(usize, i32)>,
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
    let mut meanings: Vec<Meaning> = match &options.columns {
        Some(columns) => chosen(names, columns)?,
        None => names.iter().map(|name| names::meaning(name, quantity)).collect(),
    };
    if options.columns.is_none() {
        prefer_ours(&mut meanings);
        leave_out_repeated(names, &mut meanings)?;
    }
    let preset = presets::of_header(names).filter(|_| options.columns.is_none());
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
        layout.time = Some((column, Some(9)));
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
    if let Some(unit) = &options.units {
        override_units(&mut layout, unit)?;
    }
    if options.columns.is_none() {
        layout.unknown_units = unknown_units(names, &layout, quantity)?;
    }
    let clock = [
        layout.time.map(|(column, _)| column),
        layout.fraction.map(|(column, _)| column),
        layout.date,
    ];
    layout.others = (0..names.len()).filter(|k| !used[*k] && !clock.contains(&Some(*k))).collect();
    Ok(layout)
}

/// Columns that by their name are of an inertial sensor, but for their unit.
///
/// # Errors
/// `csv_unknown_unit` where that leaves no accelerometer.
fn unknown_units(
    names: &[String],
    layout: &Layout,
    of_file: Option<Quantity>,
) -> Result<Vec<usize>> {
    let quantity = |column: usize| {
        let (bare, unit) = names::split_unit(&names[column]);
        unit.filter(|unit| !unit.is_empty())?;
        let with_unit = names::meaning(&names[column], of_file).kind;
        let quantity = names::meaning(bare, of_file).kind.quantity();
        quantity.filter(|_| with_unit == Kind::Other)
    };
    let of = |wanted| (0..names.len()).filter(move |column| quantity(*column) == Some(wanted));
    let force = of(Quantity::SpecificForce).next();
    if let Some(column) = force.filter(|_| !layout.groups.iter().any(Group::is_acceleration)) {
        let remedy =
            "write one of LSB, g, mg, m/s² in parentheses, or give --columns \"x=COLUMN:g,…\"";
        let error = Code::CsvUnknownUnit.error("its unit is unknown", remedy);
        return Err(error.at(&names[column]));
    }
    let mut found: Vec<usize> = of(Quantity::SpecificForce).collect();
    found.extend(of(Quantity::AngularRate));
    found.sort_unstable();
    Ok(found)
}

/// Where a quantity has columns with wimu's names, other names are not of it.
fn prefer_ours(meanings: &mut [Meaning]) {
    let track = |meaning: &Meaning| match meaning.kind {
        Kind::Component { quantity, origin, .. } => Some((quantity, origin)),
        _ => None,
    };
    let ours = meanings.iter().filter(|meaning| meaning.is_ours);
    let ours: Vec<_> = ours.filter_map(track).collect();
    for meaning in meanings {
        if !meaning.is_ours && track(meaning).is_some_and(|of| ours.contains(&of)) {
            meaning.kind = Kind::Other;
        }
    }
}

/// Of two columns with one meaning the first counts.
fn leave_out_repeated(names: &[String], meanings: &mut [Meaning]) -> Result<()> {
    for column in 1..names.len() {
        let Some(first) = (0..column).find(|first| meanings[*first].kind == meanings[column].kind)
        else {
            continue;
        };
        let bare = |column: usize| names::split_unit(&names[column]).0;
        match meanings[column].kind {
            Kind::Other | Kind::Time => {}
            _ if bare(first).eq_ignore_ascii_case(bare(column)) => {
                return Err(Code::CsvDuplicateColumn
                    .error(
                        format!("the column `{}` occurs twice", bare(column)),
                        "rename or remove one",
                    )
                    .at(&names[column]));
            }
            _ => meanings[column].kind = Kind::Other,
        }
    }
    Ok(())
}

fn choose_time(
    Table { names, .. }: &Table,
    meanings: &[Meaning],
    preset: Option<&Preset>,
    layout: &mut Layout,
) {
    let key = |column: usize| names::key(names::split_unit(&names[column]).0);
    let of_preset = preset.and_then(|preset| preset.time).and_then(|(name, exponent)| {
        let column = (0..names.len()).find(|column| key(*column) == name)?;
        Some((column, exponent))
    });
    let times = || (0..names.len()).filter(|column| meanings[*column].kind == Kind::Time);
    let named = times().find(|column| meanings[*column].exponent.is_some());
    let column = named.or_else(|| times().next());
    layout.time = of_preset.or_else(|| column.map(|column| (column, meanings[column].exponent)));
    layout.date =
        (0..names.len()).find(|column| ["date", "rtcdate"].contains(&key(*column).as_str()));
    // `Datum` alone has both.
    let day = times().find(|column| key(*column) == "datum");
    if let Some((day, time)) = day.zip(times().find(|column| key(*column) != "datum")) {
        (layout.date, layout.time) = (Some(day), Some((time, meanings[time].exponent)));
    }
}

/// The column of a fraction beside one of seconds: `stamp.nsec` beside `stamp.sec`.
fn fraction(names: &[String], seconds: usize) -> Option<(usize, i32)> {
    const ENDS: [(i32, &[&str]); 3] = [
        (0, &["nanosecs", "nanosec", "nsecs", "nsec", "nanoseconds"]),
        (3, &["microsecs", "microsec", "usecs", "usec", "microseconds"]),
        (6, &["millisecs", "millisec", "msecs", "msec", "milliseconds"]),
    ];
    let stem = |name: &str, ends: &[&str]| {
        let key = names::key(names::split_unit(name).0);
        ends.iter().find_map(|end| key.strip_suffix(end).map(str::to_owned))
    };
    let of = stem(&names[seconds], &["secs", "sec", "seconds"])?;
    ENDS.into_iter().find_map(|(exponent, ends)| {
        let is_part = |name: &String| stem(name, ends).is_some_and(|stem| stem == of);
        Some((names.iter().position(is_part)?, exponent))
    })
}

/// An increasing column whose name is a unit of time, or else has the word `time`. Of several units, such as seconds and
/// microseconds, each is only a part of the time.
fn less_certain_time(table: &Table, meanings: &[Meaning]) -> Option<(usize, Option<i32>)> {
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
    let width = quantity.width();
    let find = |wanted: usize| {
        let kind = Kind::Component { quantity, origin, sensor, component: wanted };
        meanings.iter().position(|meaning| meaning.kind == kind)
    };
    let columns: Vec<usize> = (0..width).filter_map(find).collect();
    if columns.len() < width {
        let ours =
            columns.first().filter(|column| meanings[**column].is_ours && quantity.width() == 3);
        return match (ours, (0..width).find(|k| find(*k).is_none())) {
            (Some(column), Some(missing)) => Err(Code::CsvMissingColumn
                .error(
                    format!("`{}` is there, and its axis {} is not", names[*column], ["X", "Y", "Z"][missing]),
                    "all three axes are needed: add it, or rename the others if they are something else",
                )
                .at(&names[*column])),
            _ => Ok(None),
        };
    }
    let implied = preset.and_then(|preset| preset.units.iter().find(|(q, _)| *q == quantity));
    let implied = match quantity {
        Quantity::Attitude => Some(Scale::Si(1.0)),
        Quantity::Position | Quantity::Velocity | Quantity::Temperature => None,
        _ => implied.and_then(|(_, unit)| units::scale(quantity, unit)),
    };
    let scales: Vec<_> = columns.iter().map(|column| meanings[*column].scale.or(implied)).collect();
    let kind = |scale: &Option<Scale>| scale.map(|scale| std::mem::discriminant(&scale));
    if let Some(k) = (1..width).find(|k| kind(&scales[*k]) != kind(&scales[0])) {
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

/// Sets the units of the accelerations and of the angular rates.
fn override_units(layout: &mut Layout, units: &str) -> Result<()> {
    let [force, rate] = scales(units)?;
    for group in &mut layout.groups {
        match (group.quantity, force, rate) {
            (Quantity::AngularRate, _, Some(rate)) => group.scales.fill(Some(rate)),
            (_, Some(force), _) if group.is_acceleration() => group.scales.fill(Some(force)),
            _ => {}
        }
    }
    Ok(())
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

/// Meaning of the columns by [`ReadOptions::columns`].
fn chosen(names: &[String], columns: &str) -> Result<Vec<Meaning>> {
    let usage = |message: String| {
        Code::Usage.error(
            message,
            "write for example --columns \"t=timestamp:ns,x=ax:g,y=ay:g,z=az:g,gx=4:deg/s\"; a column is its name, or its number from 1",
        )
    };
    let mut meanings = vec![Meaning::of(Kind::Other); names.len()];
    for part in columns.split(',') {
        let (role, column) =
            part.split_once('=').ok_or_else(|| usage(format!("`{part}` is not ROLE=COLUMN")))?;
        let kind = role_of(role.trim()).ok_or_else(|| {
            usage(format!("`{role}` is none of t, x, y, z, gx, gy, gz, mx, my, mz, temp"))
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
            (meaning.exponent, meaning.scale) = (None, None);
        }
        meaning.kind = kind;
        meaning.is_ours = true;
        if let Some(unit) = unit {
            match kind {
                Kind::Component { quantity, .. } => meaning.scale = units::scale(quantity, unit),
                _ => meaning.exponent = units::time(unit),
            }
            if meaning.scale.is_none() && meaning.exponent.is_none() {
                return Err(usage(format!("the unit `{unit}` of `{role}` is not known")));
            }
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
    let component = |quantity, component| Kind::Component {
        quantity,
        origin: Origin::Sensor,
        sensor: 0,
        component,
    };
    let axis = |text: &str| "xyz".find(text).filter(|_| text.len() == 1);
    match role {
        "t" => Some(Kind::Time),
        "temp" => Some(component(Quantity::Temperature, 0)),
        _ => match (role.strip_prefix('g'), role.strip_prefix('m')) {
            (Some(rest), _) => axis(rest).map(|k| component(Quantity::AngularRate, k)),
            (_, Some(rest)) => axis(rest).map(|k| component(Quantity::MagneticField, k)),
            _ => axis(role).map(|k| component(Quantity::SpecificForce, k)),
        },
    }
}
