//! `wimu device ports`.

use serde::Serialize;
use wimu_host::client::{Client, ConnectOptions};
use wimu_host::transport::{self, Port};
use wimu_host::{DEFAULT_BAUD, LinkUrl, Result};

use crate::arguments::Ports;
use crate::output::Output;

#[derive(Serialize)]
struct Listing {
    ports: Vec<Listed>,
}

#[derive(Serialize)]
struct Listed {
    #[serde(flatten)]
    port: Port,
    /// The device that answered, or the error; absent for a port that was not opened.
    #[serde(skip_serializing_if = "Option::is_none")]
    probe: Option<Result<String, String>>,
}

pub fn run(arguments: &Ports, output: &Output) -> Result<()> {
    let mut ports: Vec<Listed> = transport::ports()?
        .into_iter()
        .map(|port| Listed {
            probe: (arguments.probe && port.board.is_some()).then(|| probe(&port)),
            port,
        })
        .collect();
    if arguments.probe {
        match transport::nearby() {
            Ok(units) => ports.extend(units.into_iter().map(|port| Listed { port, probe: None })),
            Err(error) => output.print(format!("Bluetooth: {}; {}", error.text, error.remedy)),
        }
    }
    if ports.is_empty() {
        output.print("no serial ports; `wimu simulate` runs a board without one");
    }
    for Listed { port, probe } in &ports {
        let usb = port.usb.map_or(String::new(), |usb| format!("  usb {usb}"));
        let board = port.board.map_or(String::new(), |b| format!("  {b}"));
        let answer = match probe {
            Some(Ok(device)) => format!("  → {device}"),
            Some(Err(why)) => format!("  → {why}"),
            None => String::new(),
        };
        let unit = match &port.serial_number {
            Some(address) if port.path.starts_with("ble://") => format!("  {address}"),
            _ => String::new(),
        };
        output.print(format!("{}{usb}{board}{unit}{answer}", port.path));
    }
    output.object(&Listing { ports });
    Ok(())
}

fn probe(port: &Port) -> Result<String, String> {
    let link = LinkUrl::Serial { path: port.path.clone(), baud: DEFAULT_BAUD };
    transport::open(&link)
        .and_then(|line| Client::connect(line, &port.path, ConnectOptions::probe()))
        .map(|client| {
            let hello = client.hello();
            format!(
                "{} with {}, device {:016x}, {}",
                hello.board.name, hello.sensor.name, hello.device_id, hello.role
            )
        })
        .map_err(|error| error.text.clone())
}
