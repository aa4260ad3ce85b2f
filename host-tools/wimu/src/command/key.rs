//! `wimu device key`.

use serde_json::json;
use wimu_host::keys::{self, KeyFolder};
use wimu_host::{Code, Result};
use wimu_link::auth::DeviceKey;
use wimu_link::hello::{LinkRole, WriteAccess};

use crate::arguments::{Key, KeyAction};
use crate::command::{Connection, connect};
use crate::output::Output;

pub fn run(arguments: &Key, output: &Output) -> Result<()> {
    let link = &arguments.link;
    let folder = KeyFolder::of_user()?;
    let mut client = connect(link)?;
    let device = client.hello().device_id;
    let held = client.key_status()?;
    let ours = match held {
        Some(held) => folder.settle(device, held)?,
        None => None,
    };
    client.use_key(ours);
    let refused = |code: Code, message: &str, remedy| Err(code.error(message, remedy).at(link));
    match (arguments.action, held, ours) {
        (KeyAction::Status, ..) => {}
        (_, None, _) if is_lost(&client) => {
            return refused(
                Code::DeviceRefused,
                "the device cannot read its own key and refuses all writes",
                "erase the key by the gesture on the board's page, then run `wimu device key set`",
            );
        }
        (KeyAction::Set, Some(_), Some(_)) => {
            output.print(
                "the device already has this computer's key; `wimu device key rotate` replaces it",
            );
        }
        (KeyAction::Forget, None, _) => {
            let file = folder.file(device);
            output.print(if file.exists() {
                // The answer is not authenticated, so the only copy of the key is kept.
                let file = file.display();
                format!("the device has no key; if it was erased at the board, remove {file}")
            } else {
                "the device has no key".to_owned()
            });
        }
        (_, Some(_), None) => {
            let file = folder.file(device);
            let what = if file.exists() {
                format!("the key on the device is not the one in {}", file.display())
            } else {
                "the device has a key that this computer does not have".to_owned()
            };
            return refused(
                Code::KeyNeeded,
                &what,
                "use the computer that has it, or erase it by the gesture on the board's page",
            );
        }
        (KeyAction::Rotate, None, _) => {
            return refused(
                Code::KeyNeeded,
                "the device has no key to rotate",
                "run `wimu device key set` over the cable",
            );
        }
        (KeyAction::Forget, Some(_), Some(_)) => {
            client.forget_key()?;
            folder.forget(device)?;
            output.print("the key is erased on the device and on this computer");
        }
        (KeyAction::Set | KeyAction::Rotate, ..) => {
            store_key(&mut client, &folder, device)?;
            output.print(format!(
                "key saved in {}; back it up: without it the key must be erased at the board",
                folder.file(device).display()
            ));
        }
    }
    show(&mut client, &folder, output)
}

/// Creates a key, saves it in the folder, then stores it on the device.
fn store_key(client: &mut Connection, folder: &KeyFolder, device: u64) -> Result<()> {
    let key: DeviceKey = keys::generate()?;
    folder.prepare(device, &key)?;
    match client.set_key(key) {
        Ok(()) => {
            folder.confirm(device)?;
            folder.drop_replaced(device);
            Ok(())
        }
        Err(error) => {
            // After a refusal, or unsent, the device has the old key; otherwise it may have either, and both files are kept.
            if matches!(error.code, Code::KeyNeeded | Code::DeviceRefused | Code::NotThroughBroker)
            {
                folder.withdraw(device);
            }
            Err(error)
        }
    }
}

/// Whether the device has a key that it cannot read: it would otherwise accept writes over the cable.
fn is_lost(client: &Connection) -> bool {
    let hello = client.hello();
    hello.role == LinkRole::Cable && hello.access == WriteAccess::Locked
}

/// Which writes a link accepts, from the name of its write access.
pub fn access_text(access: &str) -> &str {
    match access {
        "key" => "signed writes only",
        other => other,
    }
}

fn show(client: &mut Connection, folder: &KeyFolder, output: &Output) -> Result<()> {
    let hello = *client.hello();
    let held = client.key_status()?;
    let known = folder.candidates(hello.device_id)?;
    let ours = known.iter().any(|key| Some(key.id()) == held);
    let proved = ours && client.use_key_among(&known).is_ok();
    let authenticated = (!known.is_empty()).then_some(proved);
    output.print(match (held, ours) {
        (None, _) if is_lost(client) => {
            "the device cannot read its key; all writes are refused".to_owned()
        }
        (None, _) => "no key: writes are accepted over the cable only".to_owned(),
        (Some(id), true) => {
            format!("key {id}, which this computer has: signed writes are accepted on both links")
        }
        (Some(id), false) => format!("key {id}, which this computer does not have"),
    });
    if authenticated == Some(false) {
        output.print("not authenticated: the device has not proved to have a key of this computer");
    }
    output.print(format!(
        "write access on the {} link: {}",
        hello.role,
        access_text(&hello.access.to_string())
    ));
    // The state of the key, never the key itself; `authenticated` is null if this computer has no key of the device.
    output.object(&json!({
        "device_id": format!("{:016x}", hello.device_id),
        "set": held.is_some(),
        "key_id": held.map(|id| id.to_string()),
        "ours": ours,
        "authenticated": authenticated,
    }));
    Ok(())
}
