//! All integration tests of `wimu-model` in one binary: one module a file.

mod corrector;
mod parameters;
