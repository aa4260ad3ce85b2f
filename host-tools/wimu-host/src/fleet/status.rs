//! The boards of a fleet as the broker knows them.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use serde::Serialize;

use super::lock;
use super::mqtt::{Heard, Mqtt, MqttConfig};
use super::state::{BoardState, GatewayState};
use super::topics::{Content, Fleet, Name, all_boards, all_gateways, board_of};
use crate::Result;

/// The states of a fleet.
#[derive(Clone, Debug, Default, Serialize)]
#[non_exhaustive]
pub struct FleetStatus {
    /// The boards by name. `alive` is false, too, where the gateway has died.
    pub boards: BTreeMap<String, BoardState>,
    /// The gateways by name.
    pub gateways: BTreeMap<String, GatewayState>,
    /// Topics whose retained messages are not states: another program publishes there.
    pub unreadable: BTreeSet<String>,
}

impl FleetStatus {
    /// The names of the boards that are alive.
    pub fn alive(&self) -> impl Iterator<Item = Name> + '_ {
        let alive = self.boards.iter().filter(|(_, state)| state.alive);
        alive.filter_map(|(name, _)| name.parse().ok())
    }

    /// Takes a message of the broker.
    pub(super) fn take(&mut self, fleet: &Name, topic: &str, payload: &[u8]) {
        if payload.is_empty() {
            // It was removed.
        } else if let Some(board) = board_of(topic, fleet, Content::State) {
            match BoardState::read(payload) {
                Some(state) => drop(self.boards.insert(board.to_string(), state)),
                None => drop(self.unreadable.insert(topic.to_owned())),
            }
        } else if let Some(state) = GatewayState::read(payload) {
            let name = topic.rsplit('/').next().unwrap_or_default();
            self.gateways.insert(name.to_owned(), state);
        } else {
            self.unreadable.insert(topic.to_owned());
        }
    }

    /// Why a board is away. It is only as alive as the session of its gateway.
    pub(super) fn why_away(&self, board: &BoardState) -> Option<String> {
        let name = &board.gateway;
        let gateway = self.gateways.get(name);
        if !gateway.is_some_and(|found| found.alive && found.session == board.session) {
            Some(format!("its gateway `{name}` has ended"))
        } else if !board.alive {
            let why = board.lost.as_deref().unwrap_or("not reached yet");
            Some(format!("the gateway `{name}` does not reach it: {why}"))
        } else {
            None
        }
    }
}

/// Reads the retained states of a fleet, listening for `time`.
///
/// # Errors
/// `link_refused` when the broker does not answer.
pub fn read(fleet: &Fleet, time: Duration) -> Result<FleetStatus> {
    let found = Arc::new(Mutex::new(FleetStatus::default()));
    let (shared, name) = (found.clone(), fleet.fleet.clone());
    let filters = vec![all_boards(&name, Content::State), all_gateways(&name)];
    let mqtt = Mqtt::start(MqttConfig::new(&fleet.broker, filters), move |heard| {
        if let Heard::Message { topic, payload, .. } = heard {
            lock(&shared).take(&name, topic, payload);
        }
    })?;
    mqtt.wait_connected()?;
    std::thread::sleep(time);
    mqtt.stop();
    let mut status = lock(&found).clone();
    for mut state in std::mem::take(&mut status.boards) {
        if let Some(why) = status.why_away(&state.1) {
            state.1.alive = false;
            state.1.lost = Some(why);
        }
        status.boards.insert(state.0, state.1);
    }
    Ok(status)
}
