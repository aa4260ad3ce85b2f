//! Bluetooth Low Energy by `btleplug`: units with the Nordic UART Service.

mod bridge;

use std::time::{Duration, Instant};

use btleplug::api::{
    Central as _, CharPropFlags, Characteristic, Manager as _, Peripheral as _, ScanFilter,
    WriteType,
};
use btleplug::platform::{Adapter, Manager, Peripheral};
use futures::stream::{Stream, StreamExt as _};
use uuid::Uuid;

use super::Port;
use super::nus::NusLink;
use crate::{Code, Result};
pub use bridge::{Bridge, Connection};

const SERVICE: Uuid = Uuid::from_u128(0x6e400001_b5a3_f393_e0a9_e50e24dcca9e);
/// Host to board.
const RX: Uuid = Uuid::from_u128(0x6e400002_b5a3_f393_e0a9_e50e24dcca9e);
/// Board to host.
const TX: Uuid = Uuid::from_u128(0x6e400003_b5a3_f393_e0a9_e50e24dcca9e);

/// Longest search for a unit, longest search for all, interval between two looks, and longest wait for a connection.
const SEARCH: Duration = Duration::from_secs(10);
const SURVEY: Duration = Duration::from_secs(4);
const GLANCE: Duration = Duration::from_millis(250);
const CONNECT: Duration = Duration::from_secs(15);
/// Opcode and handle of a write, bytes.
const ATT_HEADER: u16 = 3;

/// Connects to the unit called `name`, or with this address.
///
/// # Errors
/// `link_absent` without an adapter or the unit; `link_refused` when it does not connect or has no such service.
pub fn open(name: &str) -> Result<NusLink<Bridge>> {
    let link = format!("ble://{name}");
    let wanted = name.to_owned();
    let bridge = Bridge::start(async move || connect(&wanted).await);
    bridge.map(|bridge| NusLink::new(&link, bridge)).map_err(|error| error.at(&link))
}

/// The units with the Nordic UART Service in range; takes 4 s.
///
/// # Errors
/// `link_absent` without an adapter.
pub fn nearby() -> Result<Vec<Port>> {
    bridge::runtime()?.block_on(async {
        let adapter = adapter().await?;
        let found = search(&adapter, SURVEY, |_| false).await?;
        let ports = found.into_iter().map(|unit| Port {
            path: format!("ble://{}", unit.name.as_ref().unwrap_or(&unit.address)),
            usb: None,
            product: Some("Nordic UART Service".to_owned()),
            serial_number: Some(unit.address),
            board: None,
        });
        Ok(ports.collect())
    })
}

/// A unit in range.
struct Unit {
    peripheral: Peripheral,
    name: Option<String>,
    /// An address, or on macOS an identifier.
    address: String,
}

impl Unit {
    fn is(&self, wanted: &str) -> bool {
        let names = self.name.iter().chain([&self.address]);
        names.into_iter().any(|name| name.eq_ignore_ascii_case(wanted))
    }
}

/// The first Bluetooth adapter.
async fn adapter() -> Result<Adapter> {
    let absent = |message: String| {
        Code::LinkAbsent.error(
            message,
            "switch Bluetooth on (Linux: `sudo systemctl start bluetooth`), or use the board's cable",
        )
    };
    let manager = Manager::new().await;
    let manager = manager.map_err(|error| absent(format!("no Bluetooth service: {error}")))?;
    let adapters = manager.adapters().await;
    let adapters = adapters.map_err(|error| absent(format!("no Bluetooth adapter: {error}")))?;
    let first = adapters.into_iter().next();
    first.ok_or_else(|| absent("this computer has no Bluetooth adapter".to_owned()))
}

/// Units with the service, until `is_wanted` is true of one or `longest` is over. The wanted one is the last.
async fn search(
    adapter: &Adapter,
    longest: Duration,
    is_wanted: impl Fn(&Unit) -> bool,
) -> Result<Vec<Unit>> {
    let failed = |error: btleplug::Error| {
        Code::LinkAbsent.error(
            format!("the Bluetooth adapter does not search: {error}"),
            "switch it off and on; on macOS allow the terminal to use Bluetooth",
        )
    };
    let services = vec![SERVICE];
    adapter.start_scan(ScanFilter { services }).await.map_err(failed)?;
    let start = Instant::now();
    let mut found = Vec::new();
    while start.elapsed() < longest {
        tokio::time::sleep(GLANCE).await;
        found.clear();
        for peripheral in adapter.peripherals().await.map_err(failed)? {
            // BlueZ also lists units that do not match the filter.
            let Ok(Some(properties)) = peripheral.properties().await else {
                continue;
            };
            if !properties.services.contains(&SERVICE) {
                continue;
            }
            let id = peripheral.id().to_string();
            found.push(Unit {
                name: properties.local_name,
                address: if cfg!(target_os = "macos") {
                    id
                } else {
                    peripheral.address().to_string()
                },
                peripheral,
            });
            if found.last().is_some_and(&is_wanted) {
                break;
            }
        }
        if found.last().is_some_and(&is_wanted) {
            break;
        }
    }
    // It fails where the search has ended by itself.
    let _ = adapter.stop_scan().await;
    Ok(found)
}

/// Finds the unit and opens its service.
async fn connect(wanted: &str) -> Result<Nus> {
    let adapter = adapter().await?;
    let mut found = search(&adapter, SEARCH, |unit| unit.is(wanted)).await?;
    let Some(Unit { peripheral, .. }) = found.pop_if(|unit| unit.is(wanted)) else {
        let names = found.iter().map(|unit| unit.name.as_ref().unwrap_or(&unit.address));
        let names: Vec<_> = names.map(String::as_str).collect();
        let others = match names.as_slice() {
            [] => "no unit with the Nordic UART Service".to_owned(),
            some => some.join(", "),
        };
        return Err(Code::LinkAbsent.error(
            format!("the unit is not in range; found: {others}"),
            "check its supply and its distance, and that no other computer is connected; `wimu device ports --probe` lists units",
        ));
    };
    service(peripheral).await.map_err(|error| {
        Code::LinkRefused.error(
            format!("the unit does not connect: {error}"),
            "restart the board, and remove it from the system's list of Bluetooth devices",
        )
    })
}

/// Connects, and subscribes to what the unit sends.
async fn service(peripheral: Peripheral) -> btleplug::Result<Nus> {
    if !peripheral.is_connected().await? {
        peripheral.connect_with_timeout(CONNECT).await?;
    }
    peripheral.discover_services_with_timeout(CONNECT).await?;
    let characteristics = peripheral.characteristics();
    let find = |uuid| {
        let found = characteristics.iter().find(|one| one.uuid == uuid).cloned();
        found.ok_or_else(|| btleplug::Error::Other("it has no Nordic UART Service".into()))
    };
    let (rx, tx) = (find(RX)?, find(TX)?);
    // First: a subscription makes the unit say who it is.
    let notifications = peripheral.notifications().await?;
    peripheral.subscribe(&tx).await?;
    let values = notifications.filter_map(async |value| (value.uuid == TX).then_some(value.value));
    Ok(Nus { rx, values: Some(values.boxed()), peripheral })
}

/// An open service.
struct Nus {
    peripheral: Peripheral,
    rx: Characteristic,
    values: Option<futures::stream::BoxStream<'static, Vec<u8>>>,
}

impl Connection for Nus {
    fn longest(&self) -> usize {
        usize::from(self.peripheral.mtu().saturating_sub(ATT_HEADER))
    }

    fn confirms(&self) -> bool {
        self.rx.properties.contains(CharPropFlags::WRITE)
    }

    fn values(&mut self) -> impl Stream<Item = Vec<u8>> + Unpin + use<> {
        self.values.take().unwrap_or_else(|| futures::stream::empty().boxed())
    }

    async fn write(&self, piece: &[u8], confirmed: bool) -> std::result::Result<(), String> {
        let kind = if confirmed { WriteType::WithResponse } else { WriteType::WithoutResponse };
        let written = self.peripheral.write(&self.rx, piece, kind).await;
        written.map_err(|error| error.to_string())
    }

    async fn is_connected(&self) -> bool {
        self.peripheral.is_connected().await.unwrap_or(false)
    }

    async fn disconnect(&self) {
        // It fails if the connection has ended.
        let _ = self.peripheral.disconnect().await;
    }
}
