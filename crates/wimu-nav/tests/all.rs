//! All integration tests of `wimu-nav` in one binary: one module a file.

mod array;
mod array_filter;
mod common;
mod consistency;
mod drift;
mod filter;
mod finite;
mod jacobians;
mod journeys;
mod navigator;
mod navigator_consistency;
mod navigator_finite;
mod stationarity;
mod track;
mod unit;
