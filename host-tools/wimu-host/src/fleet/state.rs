//! Retained states of boards and gateways: birth, statistics, death.

use serde::{Deserialize, Serialize};
use wimu_link::{Hello, MAX_FRAME};

/// Schema of a board's state, and of a gateway's.
const BOARD: &str = "wimu.fleet-board/1";
const GATEWAY: &str = "wimu.fleet-gateway/1";
/// Longest state that is read, bytes.
const MAX_STATE: usize = 1 << 16;

/// State of a board as its gateway reports it, on `wimu/FLEET/BOARD/state`.
///
/// It is not signed: whoever may publish at the broker can forge it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
#[non_exhaustive]
pub struct BoardState {
    /// `wimu.fleet-board/1`.
    pub schema: String,
    /// Whether the gateway is connected to the board. It is dead, too, when the gateway of this session is.
    pub alive: bool,
    /// Name of the gateway, and its session.
    pub gateway: String,
    /// Session of the gateway, the one in the batches, in hexadecimal.
    pub session: String,
    /// UTC of this report, s.
    pub reported_utc_s: f64,
    /// Frame of the latest Hello in hexadecimal; and what it says.
    pub hello: Option<String>,
    /// Device id.
    pub device_id: Option<String>,
    /// Which link of the board.
    pub role: Option<String>,
    /// Sensor.
    pub sensor: Option<String>,
    /// Parameters in use.
    pub parameter_id: Option<String>,
    /// UTC of the calibration, s, if the board knows it.
    pub calibrated_utc_s: Option<u64>,
    /// Whether the board has reported that rests contradict its calibration.
    pub contradicted: bool,
    /// UTC of the latest bytes, s.
    pub last_seen_utc_s: Option<f64>,
    /// Raw samples received.
    pub samples: u64,
    /// Samples missing between the first and the last received.
    pub missing: u64,
    /// Damaged frames.
    pub frames_damaged: u64,
    /// Bytes received.
    pub bytes: u64,
    /// How often the link came back.
    pub reconnections: u64,
    /// Rate error of the board's clock, ppm, and standard deviation of its time, ms.
    pub clock_rate_ppm: Option<f64>,
    /// Standard deviation of device time in host time, ms.
    pub clock_sd_ms: Option<f64>,
    /// Bytes that could not be recorded.
    pub unrecorded_bytes: u64,
    /// Messages of commands forwarded.
    pub commands: u64,
    /// Messages of commands refused: unsigned writes, keys, garbage, too many.
    pub commands_refused: u64,
    /// Why it is lost.
    pub lost: Option<String>,
}

impl BoardState {
    /// A board that has not been reached yet.
    pub fn new(gateway: &str, session: u64) -> Self {
        Self {
            schema: BOARD.to_owned(),
            gateway: gateway.to_owned(),
            session: format!("{session:016x}"),
            ..Self::default()
        }
    }

    /// Reads a retained message; `None` for anything else.
    pub fn read(message: &[u8]) -> Option<Self> {
        let state: Self = read(message)?;
        (state.schema == BOARD).then_some(state)
    }

    /// Takes the board's identification.
    pub fn identify(&mut self, hello: &Hello) {
        let mut frame = [0; MAX_FRAME];
        let length = hello.encode(&mut frame).unwrap_or_default();
        self.hello = Some(frame[..length].iter().map(|byte| format!("{byte:02x}")).collect());
        self.device_id = Some(format!("{:016x}", hello.device_id));
        self.role = Some(hello.role.to_string());
        self.sensor = Some(hello.sensor.name.to_string());
        self.parameter_id = Some(hello.parameter_id.to_string());
    }

    /// Whether two states differ in more than their figures.
    pub fn differs(&self, other: &Self) -> bool {
        let key = |state: &Self| {
            (
                state.alive,
                state.samples > 0,
                state.parameter_id.clone(),
                state.contradicted,
                state.calibrated_utc_s,
                state.device_id.clone(),
            )
        };
        key(self) != key(other)
    }
}

/// State of a gateway, on `wimu/FLEET/_gateway/NAME`; its last will is the death.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
#[non_exhaustive]
pub struct GatewayState {
    /// `wimu.fleet-gateway/1`.
    pub schema: String,
    /// Whether it runs.
    pub alive: bool,
    /// Its session.
    pub session: String,
    /// Boards in its configuration.
    pub boards: usize,
}

impl GatewayState {
    /// A gateway that runs.
    pub fn new(session: u64, boards: usize) -> Self {
        Self { schema: GATEWAY.to_owned(), alive: true, session: format!("{session:016x}"), boards }
    }

    /// Reads a retained message; `None` for anything else.
    pub fn read(message: &[u8]) -> Option<Self> {
        let state: Self = read(message)?;
        (state.schema == GATEWAY).then_some(state)
    }
}

/// A state as a message.
pub fn message(state: &impl Serialize) -> Vec<u8> {
    serde_json::to_vec(state).unwrap_or_default()
}

fn read<T: serde::de::DeserializeOwned>(message: &[u8]) -> Option<T> {
    (message.len() <= MAX_STATE).then(|| serde_json::from_slice(message).ok()).flatten()
}
