//! All integration tests of `wimu-integrator` in one binary: one module a file.

mod behaviour;
mod hand;
mod inertial;
