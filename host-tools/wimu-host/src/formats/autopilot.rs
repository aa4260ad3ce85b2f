//! Common to logs of autopilots: topics of each sensor, topics of what the autopilot computes
//! from all of them, and the choice between the two.

use std::collections::BTreeMap;

use super::window::{Damage, no_inertial_data};
use super::{Source, ned};
use crate::plural::counted;
use crate::recording::{Origin, Quantity, Sink, Stamped, TrackId, TrackInfo, Unit};
use crate::{Code, Result};

/// Origin of a topic's values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    /// One of several sensors, as it measures.
    Raw(Family),
    /// Sensor values after the autopilot's calibration and filters.
    Processed(Family),
    /// States of the autopilot's navigation filter.
    Estimate,
}

/// Sensors between whose topics there is a choice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Family {
    Inertial,
    Magnetic,
}

const FAMILIES: [Family; 2] = [Family::Inertial, Family::Magnetic];

impl Family {
    /// The two between which there is a choice.
    fn roles(self) -> [Role; 2] {
        [Role::Raw(self), Role::Processed(self)]
    }
}

/// Fields of a topic that make a track.
pub(super) struct Topic {
    pub(super) name: &'static str,
    pub(super) role: Role,
    pub(super) quantity: Quantity,
    /// One array, or one field for each value.
    pub(super) fields: &'static [&'static str],
    /// SI units of one unit of the fields, where the file does not name their unit.
    pub(super) si: f64,
    /// Flags without which the values are not valid.
    pub(super) valid: &'static [&'static str],
    /// Field with the time of the values relative to the timestamp, µs.
    pub(super) relative_time: Option<&'static str>,
}

impl Topic {
    pub(super) const fn new(
        name: &'static str,
        role: Role,
        quantity: Quantity,
        fields: &'static [&'static str],
    ) -> Self {
        Self { name, role, quantity, fields, si: 1.0, valid: &[], relative_time: None }
    }

    /// The same in another unit.
    pub(super) const fn in_units_of(mut self, si: f64) -> Self {
        self.si = si;
        self
    }

    /// The track of an instance, whose message has a name of its own.
    fn track(&self, name: &str, instance: u8, stamps: Stamped, sink: &mut dyn Sink) -> TrackId {
        let estimate = self.role == Role::Estimate;
        let suffix = if estimate { " (east-north-up)" } else { "" };
        let name = format!("{name}{suffix}");
        let mut info = TrackInfo::new(name, self.quantity, Unit::Si).of_sensor(instance);
        info.corrected =
            matches!(self.role, Role::Processed(_)) && self.quantity != Quantity::Temperature;
        info.stamps = Some(stamps);
        if estimate {
            info = info.made_by(Origin::Estimate);
        }
        sink.track(info)
    }

    /// Hands a row to the sink; values of an estimate are in north-east-down axes.
    fn row(&self, track: TrackId, time_us: f64, values: [f64; 4], sink: &mut dyn Sink) {
        let [a, b, c, _] = values;
        let values = match (self.role, self.quantity) {
            (Role::Estimate, Quantity::Attitude) => ned::attitude(values),
            (Role::Estimate, _) => {
                let [a, b, c] = ned::vector([a, b, c]);
                [a, b, c, 0.0]
            }
            _ => values,
        };
        let time_ns = (time_us as i64).saturating_mul(1000);
        sink.row(track, time_ns, &values[..self.quantity.width()]);
    }
}

/// A message of a log.
pub(super) trait Message {
    /// Its topic and the instance of it.
    fn topic(&self) -> (&str, u8);
    /// Name of its tracks.
    fn name(&self, topic: &Topic) -> String;
    /// Time of the values of a topic, µs, and whether they are valid.
    fn time_us(&self, topic: &Topic) -> Option<(f64, bool)>;
    /// Values of a topic, in SI.
    fn values(&self, topic: &Topic) -> Option<[f64; 4]>;
}

/// Reads a log, hands its messages on, and returns its damage and its length in bytes.
pub(super) type Walk<'a> = dyn FnMut(&mut dyn FnMut(&dyn Message)) -> Result<(Damage, u64)> + 'a;

/// Reads a log: first the number of rows of each topic, which decides what is read, then the rows.
pub(super) fn read(
    topics: &'static [Topic],
    asked: Option<&str>,
    source: &Source,
    sink: &mut dyn Sink,
    walk: &mut Walk,
) -> Result<()> {
    let mut rows = Rows::default();
    let (damage, length) = walk(&mut |message| {
        let (topic, instance) = message.topic();
        rows.add(topic, instance);
    })?;
    damage.refuse_most(source, length)?;
    let choice = Choice::of(topics, &rows, asked, source)?;
    damage.findings(0..length).into_iter().for_each(|finding| sink.finding(finding));
    choice.report(&rows, sink);
    let mut tracks: BTreeMap<(usize, String), TrackId> = BTreeMap::new();
    walk(&mut |message| {
        let (name, instance) = message.topic();
        let read = topics.iter().enumerate().filter(|(_, topic)| topic.name == name);
        for (index, topic) in read.filter(|(_, topic)| choice.takes(topic, instance)) {
            let (Some((time_us, is_valid)), Some(values)) =
                (message.time_us(topic), message.values(topic))
            else {
                continue;
            };
            let name = message.name(topic);
            let mut alike = tracks.iter().filter(|((_, other), _)| *other == name);
            let first = alike.next().map(|(_, track)| *track);
            let stamps = first.map_or(Stamped::By(Some(1000)), Stamped::Like);
            let track = *(tracks.entry((index, name)))
                .or_insert_with_key(|(_, name)| topic.track(name, instance, stamps, sink));
            let values = if is_valid { values } else { [f64::NAN; 4] };
            topic.row(track, time_us, values, sink);
        }
    })?;
    Ok(())
}

/// Most topics that are counted; PX4 has fewer than 300.
const MAX_TOPICS: usize = 1024;

/// Number of rows of each topic and instance.
#[derive(Default)]
struct Rows(BTreeMap<String, BTreeMap<u8, usize>>);

impl Rows {
    /// Counts a row.
    fn add(&mut self, topic: &str, instance: u8) {
        if !self.0.contains_key(topic) && self.0.len() < MAX_TOPICS {
            self.0.insert(topic.to_owned(), BTreeMap::new());
        }
        if let Some(instances) = self.0.get_mut(topic) {
            *instances.entry(instance).or_default() += 1;
        }
    }

    /// Most rows of an instance of the topics of a role.
    fn most(&self, topics: &[Topic], role: Role) -> usize {
        let topics = topics.iter().filter(|topic| topic.role == role);
        let counts = topics.filter_map(|topic| self.0.get(topic.name)?.values().max());
        counts.max().copied().unwrap_or(0)
    }

    /// Topics of a role that are there.
    fn topics(&self, topics: &[Topic], role: Role) -> Vec<&'static str> {
        let topics = topics.iter().filter(|topic| topic.role == role);
        let mut names: Vec<&str> = topics.map(|topic| topic.name).collect();
        names.dedup();
        names.retain(|name| self.0.contains_key(*name));
        names
    }

    /// `sensor_accel (6 rows)`: most rows of one instance.
    fn described(&self, topics: &[&str]) -> String {
        let described = topics.iter().map(|topic| {
            let most = self.0.get(*topic).and_then(|instances| instances.values().max());
            format!("{topic} ({})", counted(most.copied().unwrap_or(0), "row"))
        });
        described.collect::<Vec<_>>().join(", ")
    }
}

/// Which topics of sensors are read: the raw ones, unless the processed ones have more rows or
/// are asked for.
struct Choice {
    topics: &'static [Topic],
    asked: Option<(&'static Topic, Option<u8>)>,
    /// Of each family.
    read: [Role; FAMILIES.len()],
}

impl Choice {
    /// # Errors
    /// `usage` for a topic that the file does not have; `no_rows` if it has no inertial data.
    fn of(
        topics: &'static [Topic],
        rows: &Rows,
        wanted: Option<&str>,
        source: &Source,
    ) -> Result<Self> {
        let most = |role| rows.most(topics, role);
        let inertial = Family::Inertial.roles();
        if inertial.iter().all(|role| most(*role) == 0) {
            let is_sensor =
                |topic: &&Topic| inertial.contains(&topic.role) && topic.quantity.width() == 3;
            let sensors = topics.iter().filter(is_sensor).map(|topic| topic.name);
            let found: Vec<String> = rows.0.keys().cloned().collect();
            let sensors = sensors.collect::<Vec<_>>().join(", ");
            return Err(no_inertial_data(source, &sensors, &found));
        }
        let mut read = FAMILIES.map(|family| {
            let [raw, processed] = family.roles();
            if most(raw) >= most(processed) { raw } else { processed }
        });
        let Some(text) = wanted else {
            return Ok(Self { topics, asked: None, read });
        };
        let asked = asked(text, topics, rows).ok_or_else(|| {
            let roles = FAMILIES.into_iter().flat_map(Family::roles);
            let found: Vec<&str> = roles.flat_map(|role| rows.topics(topics, role)).collect();
            let remedy = format!("choose one of {}", rows.described(&found));
            let text = format!("`{text}` is no topic of sensors in it");
            Code::Usage.error(text, remedy).at(source.name())
        })?;
        let role = asked.0.role;
        let families = FAMILIES.into_iter().zip(&mut read);
        families.filter(|(family, _)| family.roles().contains(&role)).for_each(|(_, r)| *r = role);
        Ok(Self { topics, asked: Some(asked), read })
    }

    /// Whether an instance of a topic is read.
    fn takes(&self, topic: &Topic, instance: u8) -> bool {
        let asked = self.asked.filter(|(asked, _)| asked.role == topic.role);
        let only = asked.and_then(|(_, instance)| instance);
        let is_read = topic.role == Role::Estimate || self.read.contains(&topic.role);
        is_read && only.is_none_or(|only| only == instance)
    }

    /// Names the topics of sensors that are read and those that are not.
    fn report(&self, rows: &Rows, sink: &mut dyn Sink) {
        for (family, role) in FAMILIES.into_iter().zip(self.read) {
            let others = family.roles().into_iter().find(|other| *other != role);
            let left = others.map(|role| rows.topics(self.topics, role)).unwrap_or_default();
            let read = rows.topics(self.topics, role);
            if let (Some(_), Some(other)) = (read.first(), left.first()) {
                let (read, left) = (rows.described(&read), rows.described(&left));
                let problem = Code::TrackChosen.note(format!("read: {read}; not read: {left}"));
                sink.finding(problem.remedy(format!("`--topic {other}` reads {other} instead")));
            }
        }
        sink.finding(Code::Clock.note("times count from the start of the autopilot"));
    }
}

/// The topic, and the instance, of `NAME` or `NAME[INSTANCE]`, if the file has it.
fn asked(
    text: &str,
    topics: &'static [Topic],
    rows: &Rows,
) -> Option<(&'static Topic, Option<u8>)> {
    let (name, instance) = match text.split_once('[') {
        Some((name, rest)) => (name, Some(rest.strip_suffix(']')?.parse().ok()?)),
        None => (text, None),
    };
    let instances = rows.0.get(name)?;
    let topic = topics.iter().find(|topic| topic.name == name && topic.role != Role::Estimate)?;
    let there = instance.is_none_or(|instance| instances.contains_key(&instance));
    there.then_some((topic, instance))
}
