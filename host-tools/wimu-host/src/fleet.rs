//! Many boards through an MQTT broker: the gateway, its messages, and `mqtt://` links.
//!
//! A [`Gateway`](gateway::Gateway) keeps one link to each board, records it, and publishes the received bytes in
//! [`Batch`]es. A client of the broker gets the same bytes with the gateway's times of arrival, and sends requests back.
//! The broker is not trusted: writes are signed by the client and verified by the board. docs/reference/fleet.md has the contract.

pub mod batch;
mod bridge;
mod commands;
pub mod config;
pub mod gateway;
mod metrics;
pub mod mqtt;
mod recording;
pub mod rollout;
mod session;
mod spool;
pub mod state;
pub mod status;
pub mod topics;
mod transport;

pub use batch::Batch;
pub use transport::open;

use crate::serve::lock;
