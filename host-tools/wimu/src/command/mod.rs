//! The commands, one module each.

pub mod align;
pub mod allan;
pub mod calibrate;
pub mod compare;
pub mod convert;
pub mod dashboard;
pub mod demo;
pub mod flash;
pub mod fleet;
pub mod gateway;
pub mod info;
pub mod key;
pub mod manual;
pub mod monitor;
pub mod navigate;
pub mod params;
pub mod ports;
pub mod record;
pub mod report_bug;
pub mod settings;
pub mod simulate;

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use wimu_host::client::{self, Client};
use wimu_host::decode::Arrival;
use wimu_host::keys::KeyFolder;
use wimu_host::transport::Transport;
use wimu_host::{Code, LinkUrl, Result};

use crate::output::Output;
use crate::progress;

/// A connection to a board over a real link.
type Connection = Client<Box<dyn Transport + Send>>;

/// Connects to the board at LINK.
fn connect(link: &str) -> Result<Connection> {
    client::connect(&link.parse::<LinkUrl>()?)
}

/// Connects to the board at LINK for writing, with its key if this computer has it.
fn connect_to_write(link: &str) -> Result<Connection> {
    let mut client = connect(link)?;
    client.use_own_key()?;
    Ok(client)
}

/// Connects to the board at LINK, for writing if the result is to be pushed.
fn connect_for(link: &str, push: bool) -> Result<Connection> {
    if push { connect_to_write(link) } else { connect(link) }
}

/// Connects to the board at LINK for reading, with its key if this computer has it and the board proves to have the
/// same. Returns whether the answers are authenticated; `None` if this computer has no key of the board.
fn connect_to_read(link: &str, output: &Output) -> Result<(Connection, Option<bool>)> {
    let mut client = connect(link)?;
    if KeyFolder::of_user().is_err() {
        return Ok((client, None));
    }
    match client.use_own_key() {
        Ok(signs) => Ok((client, signs.then_some(true))),
        Err(error) if error.code == Code::LinkLost => Err(error),
        Err(error) => {
            client.use_key(None);
            output.print(format!("not authenticated: {error}"));
            Ok((client, Some(false)))
        }
    }
}

/// The flag that Ctrl-C and SIGTERM set.
fn interrupted() -> Result<Arc<AtomicBool>> {
    progress::hide(true);
    static FLAG: OnceLock<Arc<AtomicBool>> = OnceLock::new();
    if let Some(flag) = FLAG.get() {
        return Ok(flag.clone());
    }
    let flag = FLAG.get_or_init(Arc::default).clone();
    let set = flag.clone();
    ctrlc::set_handler(move || set.store(true, Ordering::Relaxed)).map_err(|error| {
        Code::FileFailed.error(
            format!("cannot install the Ctrl-C handler: {error}"),
            "run the command in a terminal",
        )
    })?;
    Ok(flag)
}

/// The end of a command with `--for SECONDS`; `None` without it, or if it is beyond the clock.
fn deadline(time: Option<Duration>) -> Option<Instant> {
    Instant::now().checked_add(time?)
}

fn is_over(deadline: Option<Instant>, interrupted: &AtomicBool) -> bool {
    interrupted.load(Ordering::Relaxed) || deadline.is_some_and(|end| Instant::now() >= end)
}

/// Passes arrivals to `take` until it returns false, `time` is over, or Ctrl-C.
fn listen_until(
    client: &mut Connection,
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
