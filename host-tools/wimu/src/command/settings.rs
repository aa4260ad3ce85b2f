//! `wimu device settings`.

use serde::Serialize;
use wimu_host::Result;
use wimu_link::LinkRole;
use wimu_link::message::{Resolution, Settings, Streams};

use crate::arguments::{self, Carried, Change, PerLink, Switch};
use crate::command::{connect_to_read, connect_to_write, params};
use crate::output::Output;

#[derive(Serialize)]
struct Held {
    range_g: u8,
    rate_hz: u16,
    resolution: &'static str,
    zupt: bool,
    gravity_m_s2: f64,
    cable: Vec<&'static str>,
    wireless: Vec<&'static str>,
    batch: [u8; 2],
    /// Decimation of raw and corrected samples on the two links.
    every: [u8; 2],
    /// Whether the device has signed its answers; null if this computer has no key of the device.
    authenticated: Option<bool>,
}

pub fn run(action: &arguments::Settings, output: &Output) -> Result<()> {
    let (settings, authenticated) = match action {
        arguments::Settings::Get { link } => {
            let (mut client, authenticated) = connect_to_read(link, output)?;
            (client.settings()?, authenticated)
        }
        arguments::Settings::Set { link, change } => {
            let mut client = connect_to_write(link)?;
            if let Some(baud) = change.wireless_baud {
                client.set_line_rate(baud)?;
                output.print(format!(
                    "the wireless line runs at {baud} baud from the board's next start on: set its adapter alike"
                ));
            }
            let before = client.settings()?;
            let wanted = changed(before, change);
            let now = match wanted == before {
                true => before,
                false => client.set_settings(wanted)?,
            };
            params::applies(
                client.held_parameters()?.map(|(_, set)| set).as_ref(),
                now.range_g,
                output,
            );
            (now, client.signs().then_some(true))
        }
    };
    let held = Held {
        range_g: settings.range_g,
        rate_hz: settings.rate_hz,
        resolution: match settings.resolution {
            Resolution::LowPower => "low",
            Resolution::Normal => "normal",
            Resolution::High => "high",
        },
        zupt: settings.zupt,
        gravity_m_s2: f64::from(settings.gravity_um_s2) * 1e-6,
        cable: names(&settings.cable),
        wireless: names(&settings.wireless),
        batch: [settings.cable.batch, settings.wireless.batch],
        every: [settings.cable.every, settings.wireless.every],
        authenticated,
    };
    output.print(format!(
        "range ±{} g, {} Hz, {} resolution\nZUPT {}, local gravity {:.6} m/s²\ncable    {} in batches of {}{}\nwireless {} in batches of {}{}",
        held.range_g,
        held.rate_hz,
        held.resolution,
        if held.zupt { "on" } else { "off" },
        held.gravity_m_s2,
        held.cable.join(", "),
        held.batch[0],
        decimation(held.every[0]),
        held.wireless.join(", "),
        held.batch[1],
        decimation(held.every[1]),
    ));
    output.object(&held);
    Ok(())
}

fn changed(now: Settings, change: &Change) -> Settings {
    let streams = |now: Streams, wanted: &Option<Vec<Carried>>, link| {
        let batch = PerLink::of(&change.batch, link).unwrap_or(now.batch);
        let every = PerLink::of(&change.every, link).unwrap_or(now.every);
        match wanted {
            None => Streams { batch, every, ..now },
            Some(wanted) => {
                let on = |stream| wanted.contains(&stream);
                Streams {
                    raw: on(Carried::Raw),
                    corrected: on(Carried::Corrected),
                    navigation: on(Carried::Navigation),
                    environment: on(Carried::Environment),
                    batch,
                    every,
                }
            }
        }
    };
    Settings {
        range_g: change.range.unwrap_or(now.range_g),
        rate_hz: change.rate.unwrap_or(now.rate_hz),
        resolution: match change.resolution {
            None => now.resolution,
            Some(arguments::Resolution::Low) => Resolution::LowPower,
            Some(arguments::Resolution::Normal) => Resolution::Normal,
            Some(arguments::Resolution::High) => Resolution::High,
        },
        zupt: change.zupt.map_or(now.zupt, |zupt| zupt == Switch::On),
        gravity_um_s2: change.gravity.map_or(now.gravity_um_s2, |mps2| (mps2 * 1e6).round() as u32),
        cable: streams(now.cable, &change.cable, LinkRole::Cable),
        wireless: streams(now.wireless, &change.wireless, LinkRole::Wireless),
    }
}

fn decimation(every: u8) -> String {
    match every {
        0 | 1 => String::new(),
        every => format!(", decimated by {every}"),
    }
}

fn names(streams: &Streams) -> Vec<&'static str> {
    [
        (streams.raw, "raw"),
        (streams.corrected, "corrected"),
        (streams.navigation, "navigation"),
        (streams.environment, "environment"),
    ]
    .into_iter()
    .filter_map(|(on, name)| on.then_some(name))
    .collect()
}
