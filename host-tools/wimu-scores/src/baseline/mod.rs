//! Plain estimators that the command is compared with.

pub mod ranges;
pub mod zupt;
