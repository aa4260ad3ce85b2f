//! Tables in text: CSV and the like, of wimu and of other programs.
//!
//! A first pass finds the table, what its columns mean and what their values show of times, units, zero and gravity; a second
//! one hands the rows on. Each usable row makes one row of each accelerometer and gyroscope, with NaN for empty fields;
//! rows of the other tracks are left out where they are empty.

mod folder;
mod geodetic;
mod header;
mod json;
mod layout;
mod measurements;
mod names;
mod presets;
mod rows;
mod survey;
mod text;
mod times;
mod units;
mod values;
mod zero;

use std::borrow::Cow;
use std::path::Path;

use wimu_model::STANDARD_GRAVITY_MPS2 as G;

pub(crate) use geodetic::TangentPlane;
use header::Table;
pub(super) use layout::si_of;
use layout::{Group, Layout};
pub(crate) use measurements::{Column as MeasuredColumn, Measurements};
use rows::{Count, Fault};
use survey::{Column, Survey};
use times::Times;
pub(crate) use units::{ANGLE, LENGTH, NUMBER, SPEED, TIME};
use values::Conversion;

use super::{ReadOptions, Source};
use crate::recording::{Quantity, Sink, Stamped, TrackId, TrackInfo, Unit};
use crate::{Code, Problem, Result};

/// Columns of a table, at most.
const MOST_COLUMNS: usize = 1024;
/// Scalar tracks of a table, at most.
const MOST_SCALARS: usize = 64;
/// Different sensitivities in a table, at most.
const MOST_SENSITIVITIES: usize = 16;
/// Columns that a message names, at most.
const MOST_NAMED: usize = 30;

/// Whether it is text.
pub(super) fn detect(source: &Source) -> bool {
    match source.members() {
        [] => is_text(source.start()),
        _ => folder::detect(source),
    }
}

/// Whether bytes are those of a text.
fn is_text(start: &[u8]) -> bool {
    let is_utf16 = matches!(start, [0xff, 0xfe, ..] | [0xfe, 0xff, ..]);
    let is_control = |byte: &&u8| **byte < 9 || (14..32).contains(*byte) || **byte == 127;
    let controls = start.iter().filter(is_control).count();
    !start.is_empty() && (is_utf16 || 100 * controls < start.len())
}

/// Hands the tracks and rows of a table to `sink`.
pub(super) fn read(source: &Source, options: &ReadOptions, sink: &mut dyn Sink) -> Result<()> {
    match source.members() {
        [] => read_table(source, options, sink, Vec::new()),
        _ => folder::read(source, options, sink),
    }
}

/// Quantity that the name of a file says, by all of it or by one of its words, if it has three letters or more.
fn quantity_of(source: &Source) -> Option<Quantity> {
    let stem = Path::new(source.name()).file_stem()?.to_string_lossy();
    let by = |word: &str| {
        let key = names::key(word);
        names::quantity(&key).filter(|_| key.chars().count() >= 3)
    };
    let mut words = stem.split(|c: char| !c.is_alphanumeric()).filter_map(by);
    by(&stem).or_else(|| {
        let first = words.next()?;
        words.all(|other| other == first).then_some(first)
    })
}

/// Reads a table whose rows have these times, if there are any.
fn read_table(
    source: &Source,
    options: &ReadOptions,
    sink: &mut dyn Sink,
    times: Vec<i64>,
) -> Result<()> {
    let name = Path::new(source.name()).file_stem().unwrap_or_default().to_string_lossy();
    read_axes(source, &Axes { name: &name, quantity: quantity_of(source) }, options, sink, times)
}

/// What columns `x`, `y`, `z` are.
struct Axes<'a> {
    name: &'a str,
    quantity: Option<Quantity>,
}

/// Reads a table. Where the quantity of `x`, `y`, `z` is not known and nothing else is inertial, each row may name its sensor;
/// else they are taken as acceleration.
fn read_axes(
    source: &Source,
    axes: &Axes<'_>,
    options: &ReadOptions,
    sink: &mut dyn Sink,
    times: Vec<i64>,
) -> Result<()> {
    let table = header::find(source, axes.quantity)?;
    let at_header = |error: Problem| {
        let column =
            error.place.at.as_deref().map(|column| format!(", {column}")).unwrap_or_default();
        error.at(format!("{} line {}{column}", source.name(), table.line))
    };
    let mut layout = layout::of(&table, axes.quantity, options).map_err(at_header)?;
    let is_unnamed = layout.groups.is_empty() && options.columns.is_none();
    if is_unnamed {
        layout = layout::of(&table, Some(Quantity::SpecificForce), options).map_err(at_header)?;
    }
    for group in &mut layout.groups {
        if group.columns.len() == 3 && group.name == group.quantity.name() {
            axes.name.clone_into(&mut group.name);
        }
    }
    has_tracks(&table, &layout).map_err(at_header)?;
    let pairs = options.filter.as_ref().map_or(&[][..], |f| f.pairs());
    let filter = rows::filter(&table, pairs).map_err(at_header)?;
    let survey = survey::survey(source, &table, &layout, &filter)?;
    let sensors = if is_unnamed { survey.named_sensors(&layout) } else { Vec::new() };
    for (column, name, quantity) in &sensors {
        let filter = options.filter.clone().unwrap_or_default().with(&table.names[*column], name);
        let options = ReadOptions { filter: Some(filter), ..options.clone() };
        read_axes(source, &Axes { name, quantity: Some(*quantity) }, &options, sink, Vec::new())?;
    }
    if !sensors.is_empty() {
        return Ok(());
    }
    if survey.count.rows == 0 && !filter.is_empty() {
        return Err(rows::nothing_passes(source, &table, &filter)?.at(source.name()));
    }
    survey.count.check(source.name(), &table)?;
    survey.one_source(&table, &layout, !options.poses).map_err(at_header)?;
    if times::is_dot(&table, &layout, &survey) {
        layout.program = Some(presets::XSENS_DOT);
        let rates = layout.groups.iter_mut().filter(|g| g.quantity == Quantity::AngularRate);
        rates.for_each(|group| group.scales.fill(units::scale(group.quantity, "deg/s")));
    }
    let mut findings = layout_findings(&table, &layout);
    if is_unnamed {
        let text = "the columns `x`, `y`, `z` name no quantity: taken as acceleration";
        let remedy = "if they are not, say what each column is with --columns";
        findings.push(Code::TrackChosen.note(text).remedy(remedy));
    }
    let conversions = conversions(&layout, &survey, options, &mut findings).map_err(at_header)?;
    let times = match options.rate_hz {
        _ if !times.is_empty() => Times::List(times),
        Some(rate_hz) => Times::Rows { period_ns: 1e9 / rate_hz, is_assumed: false },
        None => times::choose(&table, &layout, &survey, options.poses, &mut findings),
    };
    let mut writer = Writer::new(&table, &layout, conversions, &survey, times, sink);
    let count = rows::each_row(source, &table, &filter, u64::MAX, |fields, fault| {
        writer.row(fields, fault)
    })?;
    writer.finish(findings, &count, &table);
    count.check(source.name(), &table)
}

/// Tables that go beside a recording: columns that tell them, what they are, and how they are used.
const BESIDE: [(&[&str], &str, &str); 3] = [
    (
        &["anchor", "range"],
        "these are ranges to anchors",
        "locate the unit with `wimu navigate FILE --setup anchors=ANCHORS.csv`",
    ),
    (
        &["anchor", "position e"],
        "these are positions of anchors",
        "give them beside ranges: `wimu navigate RANGES.csv --setup anchors=FILE`",
    ),
    (
        &["speed"],
        "these are speeds of a vehicle",
        "give them beside a recording: `wimu navigate RECORDING --odometry FILE`",
    ),
];

/// Refuses a table without anything inertial.
fn has_tracks(table: &Table, layout: &Layout) -> Result<()> {
    let is_axis = |name: &String| name.to_lowercase().starts_with("accelerometer ");
    let is_inertial =
        |group: &Group| matches!(group.quantity, Quantity::SpecificForce | Quantity::AngularRate);
    if layout.groups.iter().any(is_inertial) || table.names.iter().any(is_axis) {
        return Ok(());
    }
    let has =
        |name: &&str| table.names.iter().any(|n| names::split_unit(n).0.eq_ignore_ascii_case(name));
    if let Some((_, what, remedy)) = BESIDE.iter().find(|(columns, ..)| columns.iter().all(has)) {
        return Err(Code::CsvMissingColumn.error(*what, *remedy));
    }
    if !layout.groups.is_empty() {
        return Ok(());
    }
    let mut named = table.names[..table.names.len().min(MOST_NAMED)].join(", ");
    if table.names.len() > MOST_NAMED {
        named += ", …";
    }
    Err(Code::CsvMissingColumn.error(
        format!("there is no accelerometer or gyroscope among its columns: {named}"),
        "name the columns `Accelerometer X (g)`, … in LSB, g, mg or m/s², or say which they are: --columns \"t=1:s,x=2:g,y=3:g,z=4:g\"",
    ))
}

/// The program that wrote a table, and columns whose units are unknown or differ.
fn layout_findings(table: &Table, layout: &Layout) -> Vec<Problem> {
    let mut findings = Vec::new();
    if let Some(program) = layout.program {
        findings.push(Code::TrackChosen.note(format!("the columns are those of {program}")));
    }
    if let Some(first) = layout.unknown_units.first() {
        let text = format!(
            "{} columns of inertial sensors have an unknown unit, first `{}`",
            layout.unknown_units.len(),
            table.names[*first]
        );
        let remedy = "they are not read as such; give --columns with a known unit";
        findings.push(Code::UnitInferred.warning(text).remedy(remedy));
    }
    let is_mixed = |group: &&Group| group.scales.iter().any(|scale| *scale != group.scales[0]);
    for group in layout.groups.iter().filter(is_mixed) {
        let text = format!("the components of `{}` have different units", group.name);
        let remedy = "check the units in the header or in --columns";
        findings.push(Code::UnitInferred.warning(text).remedy(remedy));
    }
    findings
}

fn conversions(
    layout: &Layout,
    survey: &Survey,
    options: &ReadOptions,
    findings: &mut Vec<Problem>,
) -> Result<Vec<Conversion>> {
    let convert = |(group, samples): (&Group, &survey::Samples)| {
        let is_whole = |column: &usize| !survey.columns[*column].has_fraction;
        let is_integer = group.columns.len() == 3 && group.columns.iter().all(is_whole);
        values::conversion(group, &samples.rows, is_integer, layout.program, options, findings)
    };
    let groups = layout.groups.iter().zip(&survey.samples);
    groups.map(convert).collect()
}

/// A track that is written.
struct Output<'a> {
    group: &'a Group,
    conversion: Conversion,
    /// Column with the size of its counts.
    size: Option<usize>,
    /// Tracks by the text in that column; one without it.
    tracks: Vec<(String, TrackId)>,
    /// Whether rows are left out where all fields are empty.
    is_sparse: bool,
}

/// Hands rows to a sink.
struct Writer<'a, 'b> {
    comma: bool,
    times: Times,
    stamps: Option<Stamped>,
    outputs: Vec<Output<'a>>,
    /// Columns of scalar tracks.
    scalars: Vec<(usize, TrackId)>,
    scalars_left_out: usize,
    rows: usize,
    /// Rows whose counts have no known size.
    without_size: u64,
    sink: &'b mut dyn Sink,
}

impl<'a, 'b> Writer<'a, 'b> {
    fn new(
        table: &Table,
        layout: &'a Layout,
        conversions: Vec<Conversion>,
        survey: &Survey,
        times: Times,
        sink: &'b mut dyn Sink,
    ) -> Self {
        let mut writer = Self {
            comma: table.comma,
            stamps: times.stamped(),
            times,
            outputs: Vec::new(),
            scalars: Vec::new(),
            scalars_left_out: 0,
            rows: 0,
            without_size: 0,
            sink,
        };
        let all = layout.groups.iter().zip(conversions).zip(&survey.samples);
        for ((group, conversion), samples) in all {
            if conversion.is_left_out {
                continue;
            }
            let is_counts = matches!(conversion.unit, Unit::Counts { .. });
            let size = match group.quantity {
                Quantity::SpecificForce => layout.sensitivity,
                Quantity::AngularRate => layout.gyroscope_scale,
                _ => None,
            };
            let mut output = Output {
                group,
                size: size.filter(|_| is_counts),
                tracks: Vec::new(),
                // One column for sensors of several rates: most rows have none of it.
                is_sparse: !group.is_inertial() || 5 * samples.empty > survey.count.rows,
                conversion,
            };
            if output.size.is_none() {
                let track = writer.track(output.info(output.conversion.unit));
                output.tracks.push((String::new(), track));
            }
            writer.outputs.push(output);
        }
        let is_scalar = |column: &Column| column.numbers > column.texts;
        let scalars = layout.others.iter().filter(|column| is_scalar(&survey.columns[**column]));
        for column in scalars {
            if writer.scalars.len() == MOST_SCALARS {
                writer.scalars_left_out += 1;
                continue;
            }
            let info = TrackInfo::new(&table.names[*column], Quantity::Scalar, Unit::Si);
            let track = writer.track(info);
            writer.scalars.push((*column, track));
        }
        writer
    }

    /// A track whose rows have the times of the table.
    fn track(&mut self, mut info: TrackInfo) -> TrackId {
        (info.stamps, info.timeless) = (self.stamps, self.times.is_assumed());
        let track = self.sink.track(info);
        if let Some(Stamped::By(_)) = self.stamps {
            self.stamps = Some(Stamped::Like(track));
        }
        track
    }

    /// Hands a row on; returns why it could not be used.
    fn row(&mut self, fields: &[Cow<str>], fault: Option<Fault>) -> Option<Fault> {
        self.rows += 1;
        let Some(time) = self.times.of(self.rows - 1, fields, self.comma) else {
            return fault.or(Some(Fault::NoTime));
        };
        let mut fault = fault;
        for index in 0..self.outputs.len() {
            let output = &self.outputs[index];
            let read = match fault {
                // The row counts as one that is masked.
                Some(Fault::FieldCount(_)) if output.is_sparse => continue,
                Some(Fault::FieldCount(_)) => Ok(None),
                _ => rows::values(output.group, fields, self.comma),
            };
            let row = match read {
                Ok(Some(row)) => row,
                Ok(None) if output.is_sparse => continue,
                Ok(None) => [f64::NAN; 4],
                Err(text) => {
                    fault = fault.or(output.group.is_inertial().then_some(text));
                    [f64::NAN; 4]
                }
            };
            match self.track_of(index, fields) {
                Some(track) => self.outputs[index].hand_on(track, time, row, self.sink),
                None => self.without_size += 1,
            }
        }
        if !matches!(fault, Some(Fault::FieldCount(_))) {
            for (column, track) in &self.scalars {
                let text = fields.get(*column).map_or("", |text| text);
                let value = text::field(text, self.comma).filter(|value| value.is_finite());
                value.into_iter().for_each(|value| self.sink.row(*track, time, &[value]));
            }
        }
        fault
    }

    /// The track of an output in a row: one for each size of its counts.
    fn track_of(&mut self, index: usize, fields: &[Cow<str>]) -> Option<TrackId> {
        let output = &self.outputs[index];
        let Some(column) = output.size else {
            return output.tracks.first().map(|(_, track)| *track);
        };
        let Some(text) = fields.get(column) else {
            return output.tracks.last().map(|(_, track)| *track);
        };
        if let Some((_, track)) = output.tracks.iter().find(|(size, _)| size == text) {
            return Some(*track);
        }
        let size = text.parse().ok().filter(|size: &f64| *size > 0.0 && size.is_finite())?;
        if output.tracks.len() >= MOST_SENSITIVITIES {
            return None;
        }
        let is_rate = output.group.quantity == Quantity::AngularRate;
        let si_per_lsb = Some(if is_rate { size } else { G / size });
        let track = self.track(output.info(Unit::Counts { si_per_lsb }));
        self.outputs[index].tracks.push((text.to_string(), track));
        Some(track)
    }

    fn finish(self, mut findings: Vec<Problem>, count: &Count, table: &Table) {
        if self.without_size > 0 {
            let text = format!("{} rows of counts have no sensitivity", self.without_size);
            findings.push(Code::RowsMasked.warning(text).remedy("they are left out"));
        }
        if self.scalars_left_out > 0 {
            let text = format!("{} further columns of numbers are not read", self.scalars_left_out);
            findings.push(Code::TrackChosen.note(text));
        }
        findings.extend(count.findings(table));
        findings.into_iter().for_each(|finding| self.sink.finding(finding));
    }
}

impl Output<'_> {
    fn info(&self, unit: Unit) -> TrackInfo {
        let group = self.group;
        let mut info = TrackInfo::new(&group.name, self.conversion.quantity, unit);
        info.zero_count = self.conversion.zero.count();
        info.of_sensor(group.sensor).made_by(group.origin)
    }

    fn hand_on(&self, track: TrackId, time: i64, mut row: [f64; 4], sink: &mut dyn Sink) {
        for (value, factor) in row.iter_mut().zip(&self.conversion.factors) {
            *value = self.conversion.zero.apply(*value) * factor;
        }
        sink.row(track, time, &row[..self.group.columns.len()]);
    }
}
