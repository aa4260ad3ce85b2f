//! All integration tests of `wimu-link` in one binary: one module a file.

mod auth;
mod batches;
mod frames;
mod growth;
mod inertial_vectors;
mod messages;
mod requests;
mod vectors;
