//! A board in virtual time, and everything that can go wrong around it.

mod adxl345;
mod at_once;
mod epochs;
mod flood;
mod heading;
mod keys;
mod links;
mod lsm6dso;
mod middleman;
mod rates;
mod requests;
mod sensor;
mod tags;
mod versions;
