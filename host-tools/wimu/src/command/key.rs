//! `wimu key`.

use serde::Serialize;
use wimu_host::client::Client;
use wimu_host::keys::{self, KeyFolder};
use wimu_host::transport::Transport;
use wimu_host::{ErrorCode, HostError, Result};
use wimu_link::auth::DeviceKey;
use wimu_link::hello::{LinkRole, WriteAccess};

use crate::arguments::Key;
use crate::command::connect;
use crate::output::Output;

/// What is known of a device's key; never the key.
#[derive(Serialize)]
struct Status {
    schema: &'static str,
    status: &'static str,
    device_id: String,
    /// Whether the device has one.
    set: bool,
    /// Its name.
    key_id: Option<String>,
    /// Whether this computer has it.
    ours: bool,
    /// Whether the device has proved that; null if this computer has no key of it.
    authenticated: Option<bool>,
}

pub fn run(action: &Key, output: Output) -> Result<()> {
    let link = match action {
        Key::Set { link } | Key::Status { link } | Key::Rotate { link } | Key::Forget { link } => {
            link
        }
    };
    let folder = KeyFolder::of_user()?;
    let mut client = connect(link)?;
    let device = client.hello().device_id;
    let held = client.key_status()?;
    let ours = match held {
        Some(held) => folder.settle(device, held)?,
        None => None,
    };
    client.use_key(ours);
    match (action, held, ours) {
        (Key::Status { .. }, ..) => {}
        (_, None, _) if is_lost(&client) => {
            return Err(HostError::new(
                ErrorCode::DeviceRefused,
                "the device cannot read its own key, and takes nothing from anyone",
                "have it forget the key by the gesture that its page describes, then run wimu key set",
            )
            .at(link.clone()));
        }
        (Key::Set { .. }, Some(_), Some(_)) => {
            output.say(
                "the device has this computer's key already; wimu key rotate gives it a new one",
            );
        }
        (Key::Forget { .. }, None, _) => {
            let file = folder.file(device);
            output.say(if file.exists() {
                // It may be something in between that says so: the only copy is not thrown away.
                let file = file.display();
                format!("the device has no key; if it was erased at the board, remove {file}")
            } else {
                "the device has no key".to_owned()
            });
        }
        (_, Some(_), None) => {
            let file = folder.file(device);
            let what = if file.exists() {
                format!("the device has another key than {}", file.display())
            } else {
                "the device has a key, and this computer does not".to_owned()
            };
            return Err(HostError::new(
                ErrorCode::KeyNeeded,
                what,
                "use the computer that has it, or have the board forget it by the gesture that its \
                 page describes",
            )
            .at(link.clone()));
        }
        (Key::Rotate { .. }, None, _) => {
            return Err(HostError::new(
                ErrorCode::KeyNeeded,
                "the device has no key to rotate",
                "run wimu key set over the cable",
            )
            .at(link.clone()));
        }
        (Key::Forget { .. }, Some(_), Some(_)) => {
            client.forget_key()?;
            folder.forget(device)?;
            output.say("the device has forgotten its key, and so has this computer");
        }
        (Key::Set { .. } | Key::Rotate { .. }, ..) => {
            give(&mut client, &folder, device)?;
            output.say("the device has a new key; it is in this user's configuration folder alone");
        }
    }
    show(&mut client, &folder, output)
}

/// Makes a key and gives it to the device. It is in the folder before the device has it.
fn give<T: Transport>(client: &mut Client<T>, folder: &KeyFolder, device: u64) -> Result<()> {
    let key: DeviceKey = keys::generate()?;
    folder.prepare(device, &key)?;
    match client.set_key(key) {
        Ok(()) => {
            folder.confirm(device)?;
            // The device has proved that it has the new one.
            folder.drop_replaced(device);
            Ok(())
        }
        Err(error) => {
            // Whichever key the device has, one of the two files holds it, unless it refused.
            if matches!(
                error.code(),
                ErrorCode::KeyNeeded | ErrorCode::DeviceRefused
            ) {
                folder.withdraw(device);
            }
            Err(error)
        }
    }
}

/// Whether the device has a key and cannot read it: without one, the cable would be open.
fn is_lost<T: Transport>(client: &Client<T>) -> bool {
    let hello = client.hello();
    hello.role == LinkRole::Cable && hello.access == WriteAccess::Locked
}

fn show<T: Transport>(client: &mut Client<T>, folder: &KeyFolder, output: Output) -> Result<()> {
    let hello = *client.hello();
    let held = client.key_status()?;
    let known = folder.candidates(hello.device_id)?;
    let ours = known.iter().any(|key| Some(key.id()) == held);
    let proved = ours && client.use_key_among(&known).is_ok();
    let authenticated = (!known.is_empty()).then_some(proved);
    output.say(match (held, ours) {
        (None, _) if is_lost(client) => {
            "a key that the device itself cannot read: nobody writes".to_owned()
        }
        (None, _) => "no key: the cable writes, the wireless link does not".to_owned(),
        (Some(id), true) => format!("key {id}, which this computer has: both links write, signed"),
        (Some(id), false) => format!("key {id}, which this computer does not have"),
    });
    if authenticated == Some(false) {
        output.say("not authenticated: the device has not proved this with a key of this computer");
    }
    output.say(format!(
        "write access on the {} link: {}",
        hello.role, hello.access
    ));
    output.object(&Status {
        schema: "wimu.key/1",
        status: "ok",
        device_id: format!("{:016x}", hello.device_id),
        set: held.is_some(),
        key_id: held.map(|id| id.to_string()),
        ours,
        authenticated,
    });
    Ok(())
}
