//! Tables in text: CSV and the like, of wimu and of other programs.
//!
//! A first pass finds the table, what its columns mean and what their values show of units, zero and gravity; a second
//! one hands the rows on. Each usable row makes one row of each accelerometer and gyroscope, with NaN for empty fields;
//! rows of the other tracks are left out where they are empty.

mod clock;
mod folder;
mod gravity;
mod header;
mod infer;
mod layout;
mod names;
mod presets;
mod rows;
mod survey;
mod text;
mod timing;
mod units;
mod zero;

use std::borrow::Cow;
use std::path::Path;

use wimu_model::STANDARD_GRAVITY_MPS2 as G;

use clock::Clock;
use gravity::WithGravity;
use header::Table;
use infer::{Conversion, Evidence};
pub(super) use layout::si_of;
use layout::{Group, Layout};
use rows::{Fault, Next, Values};
use survey::Survey;
use text::{Field, field};
pub(crate) use units::acceleration_unit;

use super::{ReadOptions, Source};
use crate::recording::{Quantity, Sink, Stamps, TrackId, TrackInfo, Unit};
use crate::{Code, Problem, Result};

/// Columns of a table, at most.
const MOST_COLUMNS: usize = 1024;
/// Scalar tracks of a table, at most.
const MOST_SCALARS: usize = 64;
/// Different sensitivities in a table, at most.
const MOST_SENSITIVITIES: usize = 16;

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
        [] => {
            let mut sink = WithGravity::new(sink, true);
            read_table(source, options, &mut sink, Vec::new())?;
            sink.finish();
            Ok(())
        }
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
    let quantity = quantity_of(source);
    let table = header::find(source, quantity)?;
    let at_header = |error: crate::Problem| {
        let column =
            error.place.at.as_deref().map(|column| format!(", {column}")).unwrap_or_default();
        error.at(format!("{} line {}{column}", source.name(), table.line))
    };
    let mut layout = layout::of(&table, quantity, options).map_err(at_header)?;
    // Columns `x`, `y`, `z` of a file have its name.
    let unnamed = layout
        .groups
        .iter_mut()
        .filter(|group| group.columns.len() == 3 && group.name == group.quantity.name());
    if let Some(stem) = Path::new(source.name()).file_stem() {
        unnamed.for_each(|group| group.name = stem.to_string_lossy().into_owned());
    }
    has_tracks(&table, &layout).map_err(at_header)?;
    let pairs = options.filter.as_ref().map_or(&[][..], |f| f.pairs());
    let filter = rows::filter(&table, pairs).map_err(at_header)?;
    let survey = survey::survey(source, &table, &layout, &filter)?;
    survey.count.check(source.name(), &table)?;
    survey.one_source(&table, !options.poses).map_err(at_header)?;
    let mut findings = Vec::new();
    if timing::is_dot(&table, &layout, &survey) {
        layout.program = Some("Xsens DOT");
        let rates = layout.groups.iter_mut().filter(|g| g.quantity == Quantity::AngularRate);
        rates.for_each(|group| group.scales.fill(units::scale(group.quantity, "deg/s")));
    }
    if let Some(program) = layout.program {
        let text = format!("the columns are those of {program}");
        findings.push(Code::TrackChosen.note(text));
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
    let conversions = conversions(&layout, &survey, options, &mut findings).map_err(at_header)?;
    let clock = if !times.is_empty() {
        clock::Source::List(times)
    } else if let Some(rate_hz) = options.rate_hz {
        clock::Source::Rows { period_ns: 1e9 / rate_hz, is_assumed: false }
    } else {
        timing::choose(&table, &layout, &survey, options.poses, &mut findings)
    };
    let mut timeless = Timeless(sink);
    let sink: &mut dyn Sink = match clock {
        clock::Source::Rows { is_assumed: true, .. } => &mut timeless,
        _ => timeless.0,
    };
    let rows = |sink: &mut dyn Sink| {
        let mut writer = Writer::new(&table, &layout, conversions, &survey, sink);
        let mut clock = Clock::new(clock.clone(), table.comma);
        let count = rows::each_row(source, &table, |fields, fault| {
            if !rows::passes(&filter, fields) {
                return Next::Skip;
            }
            Next::Count(writer.row(&mut clock, fields, fault))
        })?;
        findings.extend(writer.findings());
        findings.extend(count.findings(&table));
        Ok(count)
    };
    // Means over poses are in any order.
    let count = if clock.is_stamped() && !options.poses {
        let mut stamps = Stamps::new(&mut *sink, clock.tick_ns());
        let count = rows(&mut stamps)?;
        stamps.finish();
        count
    } else {
        rows(&mut *sink)?
    };
    findings.into_iter().for_each(|finding| sink.finding(finding));
    count.check(source.name(), &table)
}

/// Marks tracks as without times of their own.
struct Timeless<'a>(&'a mut dyn Sink);

impl Sink for Timeless<'_> {
    fn track(&mut self, mut info: TrackInfo) -> TrackId {
        info.timeless = true;
        self.0.track(info)
    }

    fn row(&mut self, track: TrackId, time_ns: i64, values: &[f64]) {
        self.0.row(track, time_ns, values);
    }

    fn finding(&mut self, finding: Problem) {
        self.0.finding(finding);
    }
}

/// Refuses a table without anything inertial.
fn has_tracks(table: &Table, layout: &Layout) -> Result<()> {
    let is_axis = |name: &String| name.to_lowercase().starts_with("accelerometer ");
    if !layout.groups.is_empty() || table.names.iter().any(is_axis) {
        return Ok(());
    }
    let mut named = table.names[..table.names.len().min(30)].join(", ");
    if table.names.len() > 30 {
        named += ", …";
    }
    Err(Code::CsvMissingColumn.error(
        format!("there is no accelerometer or gyroscope among its columns: {named}"),
        "name the columns `Accelerometer X (g)`, … in LSB, g, mg or m/s², or say which they are: --columns \"t=1:s,x=2:g,y=3:g,z=4:g\"",
    ))
}

fn conversions(
    layout: &Layout,
    survey: &Survey,
    options: &ReadOptions,
    findings: &mut Vec<Problem>,
) -> Result<Vec<Conversion>> {
    let convert = |(group, samples): (&Group, &survey::Samples)| {
        let columns = group.columns.iter().map(|column| &survey.columns[*column]);
        let evidence = Evidence {
            program: layout.program,
            is_own: layout.program.is_none() && group.name.starts_with("Accelerometer"),
            samples: &samples.rows,
            is_integer: group.columns.len() == 3
                && columns.clone().all(|column| !column.has_fraction),
            zero_count: options.zero_count.or(options.stored_zero_count),
        };
        infer::conversion(group, evidence, findings)
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
    outputs: Vec<Output<'a>>,
    /// Columns of scalar tracks.
    scalars: Vec<(usize, TrackId)>,
    scalars_left_out: usize,
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
        sink: &'b mut dyn Sink,
    ) -> Self {
        let mut outputs = Vec::new();
        let all = layout.groups.iter().zip(conversions).zip(&survey.samples);
        for ((group, conversion), samples) in
            all.filter(|((_, conversion), _)| !conversion.is_left_out)
        {
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
                output.add_track(String::new(), output.conversion.unit, sink);
            }
            outputs.push(output);
        }
        let is_scalar = |column: &&usize| {
            let column = &survey.columns[**column];
            column.numbers > column.texts
        };
        let columns: Vec<usize> = layout.others.iter().filter(is_scalar).copied().collect();
        let scalars = columns.iter().take(MOST_SCALARS).map(|column| {
            let info = TrackInfo::new(&table.names[*column], Quantity::Scalar, Unit::Si);
            (*column, sink.track(info))
        });
        Self {
            comma: table.comma,
            outputs,
            scalars: scalars.collect(),
            scalars_left_out: columns.len().saturating_sub(MOST_SCALARS),
            without_size: 0,
            sink,
        }
    }

    /// Hands a row on; returns why it could not be used.
    fn row(
        &mut self,
        clock: &mut Clock,
        fields: &[Cow<str>],
        fault: Option<Fault>,
    ) -> Option<Fault> {
        let Some(time) = clock.next_time(fields) else {
            return fault.or(Some(Fault::NoTime));
        };
        if let Some(fault) = fault {
            self.masked(time);
            return Some(fault);
        }
        let mut has_text = false;
        for output in &mut self.outputs {
            let values = rows::values(output.group, fields, self.comma);
            let row = match values {
                Values::Empty if output.is_sparse => continue,
                Values::Empty => [f64::NAN; 4],
                Values::Some(row) => row,
                Values::Text => {
                    has_text |= output.group.is_inertial();
                    [f64::NAN; 4]
                }
            };
            match output.track(fields, self.sink) {
                Some(track) => output.hand_on(track, time, row, self.sink),
                None => self.without_size += 1,
            }
        }
        for (column, track) in &self.scalars {
            if let Field::Number(value) =
                field(fields.get(*column).map_or("", |text| text), self.comma)
            {
                self.sink.row(*track, time, &[value]);
            }
        }
        has_text.then_some(Fault::NoNumber)
    }

    /// Hands on a row without values.
    fn masked(&mut self, time: i64) {
        for output in self.outputs.iter().filter(|output| !output.is_sparse) {
            if let Some((_, track)) = output.tracks.last() {
                let width = output.group.columns.len();
                self.sink.row(*track, time, &[f64::NAN; 4][..width]);
            }
        }
    }

    fn findings(&self) -> Vec<Problem> {
        let mut findings = Vec::new();
        if self.without_size > 0 {
            let text = format!("{} rows of counts have no sensitivity", self.without_size);
            let remedy = "they are left out";
            findings.push(Code::RowsMasked.warning(text).remedy(remedy));
        }
        if self.scalars_left_out > 0 {
            let left_out = self.scalars_left_out;
            let text = format!("{left_out} further columns of numbers are not read");
            findings.push(Code::TrackChosen.note(text));
        }
        findings
    }
}

impl Output<'_> {
    fn add_track(&mut self, size: String, unit: Unit, sink: &mut dyn Sink) -> TrackId {
        let group = self.group;
        let mut info = TrackInfo::new(&group.name, self.conversion.quantity, unit);
        info.zero_count = self.conversion.zero.count();
        let track = sink.track(info.of_sensor(group.sensor).made_by(group.origin));
        self.tracks.push((size, track));
        track
    }

    /// The track of a row: one for each size of its counts.
    fn track(&mut self, fields: &[Cow<str>], sink: &mut dyn Sink) -> Option<TrackId> {
        let Some(column) = self.size else {
            return self.tracks.first().map(|(_, track)| *track);
        };
        let text = fields.get(column)?;
        if let Some((_, track)) = self.tracks.iter().find(|(size, _)| size == text) {
            return Some(*track);
        }
        let size = text.parse().ok();
        let size = size.filter(|size: &f64| *size > 0.0 && size.is_finite())?;
        let is_rate = self.group.quantity == Quantity::AngularRate;
        let si_per_lsb = Some(if is_rate { size } else { G / size });
        let unit = Unit::Counts { si_per_lsb };
        (self.tracks.len() < MOST_SENSITIVITIES)
            .then(|| self.add_track(text.to_string(), unit, sink))
    }

    fn hand_on(&self, track: TrackId, time: i64, mut row: [f64; 4], sink: &mut dyn Sink) {
        for (value, factor) in row.iter_mut().zip(&self.conversion.factors) {
            *value = self.conversion.zero.apply(*value) * factor;
        }
        sink.row(track, time, &row[..self.group.columns.len()]);
    }
}
