//! Common to logs of autopilots: topics of each sensor, topics of what the autopilot computes
//! from all of them, and the choice between the two.

use std::collections::BTreeMap;

use super::window::no_inertial_data;
use super::{ReadOptions, Source, ned};
use crate::plural::counted;
use crate::recording::{Origin, Quantity, Sink, TrackId, TrackInfo, Unit};
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
    pub(super) fn track(&self, name: &str, instance: u8, sink: &mut dyn Sink) -> TrackId {
        let estimate = self.role == Role::Estimate;
        let name = match estimate {
            true => format!("{name} (east-north-up)"),
            false => name.to_owned(),
        };
        let mut info = TrackInfo::new(name, self.quantity, Unit::Si).of_sensor(instance);
        info.corrected =
            matches!(self.role, Role::Processed(_)) && self.quantity != Quantity::Temperature;
        if estimate {
            info = info.made_by(Origin::Estimate);
        }
        sink.track(info)
    }

    /// Hands a row to the sink; values of an estimate are in north-east-down axes.
    pub(super) fn row(&self, track: TrackId, time_us: f64, values: [f64; 4], sink: &mut dyn Sink) {
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

/// Most topics that are counted; PX4 has fewer than 300.
const MAX_TOPICS: usize = 1024;

/// Number of rows of each topic and instance.
#[derive(Default)]
pub(super) struct Rows(BTreeMap<String, BTreeMap<u8, usize>>);

impl Rows {
    /// Counts a row.
    pub(super) fn add(&mut self, topic: &str, instance: u8) {
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

    /// `sensor_accel (3 instances, 6 rows)`: most rows of one instance.
    fn described(&self, topics: &[&str]) -> String {
        let described = topics.iter().map(|topic| {
            let instances = self.0.get(*topic);
            let most = instances.and_then(|instances| instances.values().max());
            let rows = counted(most.copied().unwrap_or(0), "row");
            match instances.map_or(0, BTreeMap::len) {
                0 | 1 => format!("{topic} ({rows})"),
                several => format!("{topic} ({several} instances, {rows})"),
            }
        });
        described.collect::<Vec<_>>().join(", ")
    }
}

/// Which topics of sensors are read: the raw ones, unless the processed ones have more rows or
/// are asked for.
pub(super) struct Choice {
    topics: &'static [Topic],
    asked: Option<(&'static Topic, Option<u8>)>,
    raw: [bool; FAMILIES.len()],
}

impl Choice {
    /// # Errors
    /// `usage` for a topic that the file does not have; `no_rows` if it has no inertial data.
    pub(super) fn of(
        topics: &'static [Topic],
        rows: &Rows,
        options: &ReadOptions,
        source: &Source,
    ) -> Result<Self> {
        let inertial = [Role::Raw(Family::Inertial), Role::Processed(Family::Inertial)];
        if inertial.iter().all(|role| rows.most(topics, *role) == 0) {
            let wanted: Vec<&str> = topics
                .iter()
                .filter(|topic| inertial.contains(&topic.role) && topic.quantity.width() == 3)
                .map(|topic| topic.name)
                .collect();
            let found: Vec<String> = rows.0.keys().cloned().collect();
            return Err(no_inertial_data(source, &wanted.join(", "), &found));
        }
        let mut choice = Self {
            topics,
            asked: None,
            raw: FAMILIES.map(|family| {
                let most = |role| rows.most(topics, role);
                most(Role::Raw(family)) >= most(Role::Processed(family))
            }),
        };
        if let Some(text) = &options.topic {
            let asked = asked(text, topics, rows).ok_or_else(|| {
                let found = roles().flat_map(|role| rows.topics(topics, role));
                let found: Vec<&str> = found.collect();
                Code::Usage
                    .error(
                        format!("`{text}` is no topic of sensors in it"),
                        format!("choose one of {}", rows.described(&found)),
                    )
                    .at(source.name())
            })?;
            match asked.0.role {
                Role::Raw(family) => choice.raw[family as usize] = true,
                Role::Processed(family) => choice.raw[family as usize] = false,
                Role::Estimate => (),
            }
            choice.asked = Some(asked);
        }
        Ok(choice)
    }

    /// Whether an instance of a topic is read.
    pub(super) fn takes(&self, topic: &Topic, instance: u8) -> bool {
        let asked = self.asked.filter(|(asked, _)| asked.role == topic.role);
        let only = asked.and_then(|(_, instance)| instance);
        let role = match topic.role {
            Role::Raw(family) => self.raw[family as usize],
            Role::Processed(family) => !self.raw[family as usize],
            Role::Estimate => true,
        };
        role && only.is_none_or(|only| only == instance)
    }

    /// Names the topics of sensors that are read and those that are not.
    pub(super) fn report(&self, rows: &Rows, sink: &mut dyn Sink) {
        for family in FAMILIES {
            let (read, left) = match self.raw[family as usize] {
                true => (Role::Raw(family), Role::Processed(family)),
                false => (Role::Processed(family), Role::Raw(family)),
            };
            let [read, left] = [read, left].map(|role| rows.topics(self.topics, role));
            if let (Some(_), Some(other)) = (read.first(), left.first()) {
                let (read, left) = (rows.described(&read), rows.described(&left));
                let evidence = format!("read: {read}; not read: {left}");
                let finding = Code::TrackChosen.note(evidence);
                sink.finding(finding.remedy(format!("`--topic {other}` reads {other} instead")));
            }
        }
        let evidence = "times count from the start of the autopilot";
        sink.finding(Code::Clock.note(evidence));
    }
}

/// Roles between which there is a choice.
fn roles() -> impl Iterator<Item = Role> {
    let roles = |family| [Role::Raw(family), Role::Processed(family)];
    FAMILIES.into_iter().flat_map(roles)
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
