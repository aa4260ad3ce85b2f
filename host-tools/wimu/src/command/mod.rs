//! One module a command.

pub mod align;
pub mod allan;
mod array;
pub mod calibrate;
pub mod compare;
pub mod demo;
pub mod export;
pub mod flash;
pub mod info;
pub mod key;
mod live;
pub mod monitor;
pub mod navigate;
pub mod params;
pub mod ports;
pub mod record;
pub mod settings;
pub mod simulate;

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use wimu_host::client::{self, Client};
use wimu_host::keys::KeyFolder;
use wimu_host::mcap_file::Wholeness;
use wimu_host::transport::Transport;
use wimu_host::{ErrorCode, HostError, LinkUrl, Result};

use crate::output::Output;

/// A connection to a board over a real link.
type Connection = Client<Box<dyn Transport + Send>>;

/// Connects to the board behind LINK.
fn connect(link: &str) -> Result<Connection> {
    client::connect(&link.parse::<LinkUrl>()?)
}

/// Connects to the board behind LINK, to write: with its key, if this computer has one of it.
fn connect_to_write(link: &str) -> Result<Connection> {
    let mut client = connect(link)?;
    let known = KeyFolder::of_user()?.candidates(client.hello().device_id)?;
    client.use_key_among(&known)?;
    Ok(client)
}

/// Connects to the board behind LINK, to read: with its key, if this computer has one of it, and
/// without where the board does not prove that it has it. Returns whether what is read is proved;
/// `None` if this computer has no key of the board.
fn connect_to_read(link: &str, output: Output) -> Result<(Connection, Option<bool>)> {
    let mut client = connect(link)?;
    let Ok(folder) = KeyFolder::of_user() else {
        return Ok((client, None));
    };
    let known = folder.candidates(client.hello().device_id);
    match known.and_then(|known| client.use_key_among(&known)) {
        Ok(signs) => Ok((client, signs.then_some(true))),
        Err(error) if error.code() == ErrorCode::LinkLost => Err(error),
        Err(error) => {
            client.use_key(None);
            output.say(format!("not authenticated: {error}"));
            Ok((client, Some(false)))
        }
    }
}

/// Says what is wrong with a recording's file, if anything.
fn say_fault(wholeness: Wholeness, output: Output) {
    if let Some(fault) = wholeness.fault() {
        output.say(format!("  {fault}"));
    }
}

/// Refuses to write over what is being read.
fn not_over_input(input: &Path, output: Option<&Path>) -> Result<()> {
    let same = output.is_some_and(|output| {
        match (std::fs::canonicalize(input), std::fs::canonicalize(output)) {
            (Ok(input), Ok(output)) => input == output,
            _ => false,
        }
    });
    if same {
        return Err(HostError::new(
            ErrorCode::Usage,
            "the output is the input: it would be destroyed",
            "name another file with -o",
        )
        .at(input.display().to_string()));
    }
    Ok(())
}

/// A flag that Ctrl-C and a request to end set.
fn interrupted() -> Result<Arc<AtomicBool>> {
    let flag = Arc::new(AtomicBool::new(false));
    let set = flag.clone();
    ctrlc::set_handler(move || set.store(true, Ordering::Relaxed)).map_err(|error| {
        HostError::new(
            ErrorCode::FileFailed,
            format!("Ctrl-C cannot be caught: {error}"),
            "run the command in a terminal",
        )
    })?;
    Ok(flag)
}

/// When a command that was given `--for SECONDS` ends.
fn deadline(seconds: Option<f64>) -> Result<Option<Instant>> {
    seconds
        .map(|seconds| {
            Duration::try_from_secs_f64(seconds)
                .ok()
                .and_then(|duration| Instant::now().checked_add(duration))
                .ok_or_else(|| {
                    HostError::new(
                        ErrorCode::Usage,
                        format!("--for {seconds} is no time"),
                        "give seconds, 0 or more",
                    )
                })
        })
        .transpose()
}

fn is_over(deadline: Option<Instant>, interrupted: &AtomicBool) -> bool {
    interrupted.load(Ordering::Relaxed) || deadline.is_some_and(|end| Instant::now() >= end)
}
