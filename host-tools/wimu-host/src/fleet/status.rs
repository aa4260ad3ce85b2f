//! The boards of a fleet as the broker knows them.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use serde::Serialize;

use super::mqtt::{Heard, Mqtt, MqttConfig};
use super::state::{BoardState, GatewayState};
use super::topics::{Content, Fleet, Name, all_boards, all_gateways, board_of};
use crate::transport::now;
use crate::{ErrorCode, Result};

/// Longest wait for the broker.
const PATIENCE: Duration = Duration::from_secs(5);

/// The states of a fleet.
#[derive(Clone, Debug, Default, Serialize)]
#[non_exhaustive]
pub struct FleetStatus {
    /// The boards by name. `alive` is false, too, where the gateway has died.
    pub boards: BTreeMap<String, BoardState>,
    /// The gateways by name.
    pub gateways: BTreeMap<String, GatewayState>,
    /// Retained messages that are no state: someone else publishes there.
    pub unreadable: u64,
}

impl FleetStatus {
    /// The names of the boards that are alive.
    pub fn alive(&self) -> impl Iterator<Item = Name> + '_ {
        let alive = self.boards.iter().filter(|(_, state)| state.alive);
        alive.filter_map(|(name, _)| name.parse().ok())
    }

    fn take(&mut self, fleet: &Name, topic: &str, payload: &[u8]) {
        if let Some(board) = board_of(topic, fleet, Content::State) {
            match BoardState::read(payload) {
                Some(state) => drop(self.boards.insert(board.to_string(), state)),
                None => self.unreadable += 1,
            }
        } else if let Some(state) = GatewayState::read(payload) {
            let name = topic.rsplit('/').next().unwrap_or_default();
            self.gateways.insert(name.to_owned(), state);
        } else {
            self.unreadable += 1;
        }
    }

    /// A board is only as alive as the session of its gateway.
    fn bury(&mut self) {
        for state in self.boards.values_mut() {
            let gateway = self.gateways.get(&state.gateway);
            if state.alive
                && !gateway.is_some_and(|gateway| gateway.alive && gateway.session == state.session)
            {
                state.alive = false;
                state.lost = Some(format!("gateway `{}` has ended", state.gateway));
            }
        }
    }
}

/// Reads the retained states of a fleet, listening for `time`.
///
/// # Errors
/// `link_refused` when the broker does not answer.
pub fn read(fleet: &Fleet, time: Duration) -> Result<FleetStatus> {
    let found = Arc::new(Mutex::new((None, String::new(), FleetStatus::default())));
    let (shared, name) = (found.clone(), fleet.fleet.clone());
    let filters = vec![all_boards(&name, Content::State), all_gateways(&name)];
    let mqtt = Mqtt::start(MqttConfig::new(&fleet.broker, filters), move |heard| {
        let mut found = shared.lock().unwrap_or_else(PoisonError::into_inner);
        match heard {
            Heard::Connected => found.0 = Some(now()),
            Heard::Lost(why) => why.clone_into(&mut found.1),
            Heard::Message { topic, payload, .. } => found.2.take(&name, topic, payload),
        }
    })?;
    let began = now();
    loop {
        std::thread::sleep(Duration::from_millis(20));
        let mut found = found.lock().unwrap_or_else(PoisonError::into_inner);
        match found.0 {
            Some(connected) if now() >= connected + time => {
                let mut status = std::mem::take(&mut found.2);
                drop(found);
                mqtt.stop();
                status.bury();
                return Ok(status);
            }
            None if now() >= began + PATIENCE => {
                return Err(ErrorCode::LinkRefused
                    .error(
                        format!("the broker does not answer: {}", found.1),
                        "start it, or check address, user and password",
                    )
                    .at(fleet.broker.to_string()));
            }
            _ => {}
        }
    }
}
