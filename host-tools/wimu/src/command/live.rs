//! A link that is listened to until enough has come.

use std::time::Duration;

use wimu_host::client::Client;
use wimu_host::decode::Arrival;
use wimu_host::transport::Transport;
use wimu_host::{ErrorCode, HostError, Result};

use crate::command::{deadline, interrupted, is_over};

/// Hands `take` what the link brings until that is false, the time `seconds` is over, or Ctrl-C.
pub fn listen<T: Transport>(
    client: &mut Client<T>,
    seconds: Option<f64>,
    mut take: impl FnMut(&Arrival) -> Result<bool>,
) -> Result<()> {
    let end = deadline(seconds)?;
    let stop = interrupted()?;
    while !is_over(end, &stop) {
        let arrival = client.next_event(Duration::from_millis(100))?;
        if let Some(arrival) = arrival
            && !take(&arrival)?
        {
            break;
        }
    }
    Ok(())
}

/// `flag` was given with something else than a LINK.
pub fn needs_link(flag: &str, remedy: &str) -> HostError {
    HostError::new(ErrorCode::Usage, format!("{flag} needs a LINK"), remedy)
}
