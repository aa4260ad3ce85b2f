//! All integration tests of `wimu-nav` in one binary: one module a file.

mod array;
mod array_filter;
mod common;
mod consistency;
mod filter;
mod finite;
mod jacobians;
mod mixture;
mod multi_range;
mod navigator;
mod ranges;
mod smoother;
mod stance;
mod stationarity;
mod vehicle;
