//! End-to-end tests of wimu: see `tests/`. Golden wire vectors are in `vectors/`.
