//! All integration tests of `wimu-lsm6dso` in one binary: one module a file.

mod fifo;
mod registers;
