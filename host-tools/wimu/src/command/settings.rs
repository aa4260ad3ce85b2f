//! `wimu device settings`.

use serde::Serialize;
use wimu_host::Result;
use wimu_host::client::Client;
use wimu_host::transport::Transport;
use wimu_link::LinkRole;
use wimu_link::message::{Resolution, Settings, Streams};

use crate::arguments::{self, Carried, Change, PerLink, Switch};
use crate::command::{connect_to_read, connect_to_write, params};
use crate::output::Output;

/// Settings that a device holds.
#[derive(Serialize)]
pub struct Held {
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
    let held = match action {
        arguments::Settings::Get { link } => {
            let (mut client, authenticated) = connect_to_read(link, output)?;
            Held { authenticated, ..Held::from(client.settings()?) }
        }
        arguments::Settings::Set { link, change } => {
            let mut client = connect_to_write(link)?;
            if let Some(baud) = change.wireless_baud {
                output.print(format!(
                    "the wireless line runs at {baud} baud from the board's next start on: set its adapter alike"
                ));
            }
            let held = exchange(&mut client, Some(change))?;
            let set = client.held_parameters()?.map(|(_, set)| set);
            params::applies(set.as_ref(), held.range_g, output);
            held
        }
    };
    output.print(held.text());
    output.object(&held);
    Ok(())
}

/// Changes the settings of a device, signed if this computer has its key; returns those that it holds then.
pub fn exchange<T: Transport>(client: &mut Client<T>, change: Option<&Change>) -> Result<Held> {
    let Some(change) = change else {
        return Ok(Held::from(client.settings()?));
    };
    client.use_own_key()?;
    if let Some(baud) = change.wireless_baud {
        client.set_line_rate(baud)?;
    }
    let mut now = client.settings()?;
    let wanted = changed(now, change);
    if wanted != now {
        now = client.set_settings(wanted)?;
    }
    Ok(Held { authenticated: client.signs().then_some(true), ..Held::from(now) })
}

impl From<Settings> for Held {
    fn from(settings: Settings) -> Self {
        Self {
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
            authenticated: None,
        }
    }
}

impl Held {
    fn text(&self) -> String {
        let zupt = if self.zupt { "on" } else { "off" };
        let mut text = format!(
            "range ±{} g, {} Hz, {} resolution\nZUPT {zupt}, local gravity {:.6} m/s²",
            self.range_g, self.rate_hz, self.resolution, self.gravity_m_s2
        );
        for (k, (link, streams)) in
            [("cable   ", &self.cable), ("wireless", &self.wireless)].into_iter().enumerate()
        {
            text += &format!("\n{link} {} in batches of {}", streams.join(", "), self.batch[k]);
            if self.every[k] > 1 {
                text += &format!(", decimated by {}", self.every[k]);
            }
        }
        text
    }
}

fn changed(now: Settings, change: &Change) -> Settings {
    let streams = |now: Streams, wanted: &Option<Vec<Carried>>, link| {
        let now = Streams {
            batch: PerLink::of(&change.batch, link).unwrap_or(now.batch),
            every: PerLink::of(&change.every, link).unwrap_or(now.every),
            ..now
        };
        let Some(wanted) = wanted else { return now };
        Streams {
            raw: wanted.contains(&Carried::Raw),
            corrected: wanted.contains(&Carried::Corrected),
            navigation: wanted.contains(&Carried::Navigation),
            environment: wanted.contains(&Carried::Environment),
            ..now
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

fn names(streams: &Streams) -> Vec<&'static str> {
    let all = [
        (streams.raw, "raw"),
        (streams.corrected, "corrected"),
        (streams.navigation, "navigation"),
        (streams.environment, "environment"),
    ];
    all.into_iter().filter_map(|(on, name)| on.then_some(name)).collect()
}
