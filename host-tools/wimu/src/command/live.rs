//! Listening to a link.

use std::time::Duration;

use wimu_host::Result;
use wimu_host::client::Client;
use wimu_host::decode::Arrival;
use wimu_host::transport::Transport;

use crate::command::{deadline, interrupted, is_over};

/// Passes arrivals to `take` until it returns false, `time` is over, or Ctrl-C.
pub fn listen<T: Transport>(
    client: &mut Client<T>,
    time: Option<Duration>,
    mut take: impl FnMut(&Arrival) -> Result<bool>,
) -> Result<()> {
    let end = deadline(time);
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
