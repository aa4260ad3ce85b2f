//! Every register access, against mock buses.

mod adxl345;
mod bench;
mod lsm303agr;
mod lsm6dso;
mod words;
