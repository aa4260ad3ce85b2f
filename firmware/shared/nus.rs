//! The Nordic UART Service: a serial port over Bluetooth Low Energy. What is generic about it is
//! [`wimu_embassy::PacketLink`].

use embassy_futures::join::join;
use embassy_futures::select::select;
use embassy_time::Timer;
use trouble_host::prelude::*;
use wimu_embassy::PacketLink;

use crate::radio::{Controller, ControllerError};

/// Connections at a time.
const CONNECTIONS: usize = 1;
/// Signalling and attributes.
const CHANNELS: usize = 2;
/// Longest packet of the service, bytes: what fits a packet of the radio after the headers of L2CAP and ATT.
const LONGEST: usize = DefaultPacketPool::MTU - 4 - ATT_HEADER;
/// Opcode and handle of a notification, bytes.
const ATT_HEADER: usize = 3;
/// Longest data of a packet of the radio, bytes, and the time it takes at 1 Mbit/s, µs (Core Specification, vol. 6,
/// part B, 4.5.10).
const DATA_LENGTH: (u16, u16) = (251, 2120);
/// 6e400001-b5a3-f393-e0a9-e50e24dcca9e, low byte first.
const SERVICE: [u8; 16] = 0x6e400001_b5a3_f393_e0a9_e50e24dcca9e_u128.to_le_bytes();
/// Delay before what has failed for want of memory is tried again, ms.
const AGAIN_MS: u64 = 2;

#[gatt_server]
struct Server {
    uart: UartService,
}

#[gatt_service(uuid = "6e400001-b5a3-f393-e0a9-e50e24dcca9e")]
struct UartService {
    /// Host to board. Its value is passed on, not stored.
    #[characteristic(uuid = "6e400002-b5a3-f393-e0a9-e50e24dcca9e", write, write_without_response)]
    rx: (),
    /// Board to host.
    #[characteristic(uuid = "6e400003-b5a3-f393-e0a9-e50e24dcca9e", notify)]
    tx: (),
}

type Connection<'a> = GattConnection<'a, 'a, DefaultPacketPool>;

/// Runs the host stack and serves one connection after another.
#[embassy_executor::task]
pub async fn run(controller: Controller, device_id: u64, link: &'static PacketLink) -> ! {
    let mut resources: HostResources<DefaultPacketPool, CONNECTIONS, CHANNELS> =
        HostResources::new();
    let stack = trouble_host::new(controller, &mut resources)
        .set_random_address(address(device_id))
        .build();
    let mut runner = stack.runner();
    let mut peripheral = stack.peripheral();
    let name = name(device_id);
    let name = str::from_utf8(&name).unwrap_or("wimu");
    let identity = GapConfig::Peripheral(PeripheralConfig {
        name,
        appearance: &appearance::sensor::MOTION_SENSOR,
    });
    // The name is short enough.
    let server = Server::new_with_config(identity).unwrap();
    let host = async {
        loop {
            // It ends only with a fault of the controller: the reset is reported.
            runner.run().await.unwrap();
        }
    };
    let service = async {
        loop {
            if let Ok(connection) = advertise(name, &mut peripheral, &server).await {
                let (length, time_us) = DATA_LENGTH;
                // A host that knows no long packets gets short ones.
                let raw = connection.raw();
                let _ = raw.update_data_length(&stack, length, time_us).await;
                select(receive(&server, &connection, link), send(&server, &connection, link)).await;
                link.disconnect();
            } else {
                Timer::after_millis(AGAIN_MS).await;
            }
        }
    };
    match join(host, service).await {}
}

/// Waits for a host.
async fn advertise<'a>(
    name: &str,
    peripheral: &mut Peripheral<'a, Controller, DefaultPacketPool>,
    server: &'a Server<'_>,
) -> Result<Connection<'a>, BleHostError<ControllerError>> {
    let (mut advertised, mut response) = ([0; 31], [0; 31]);
    let flags = AdStructure::Flags(LE_GENERAL_DISCOVERABLE | BR_EDR_NOT_SUPPORTED);
    let service = AdStructure::CompleteServiceUuids128(&[SERVICE]);
    let length = AdStructure::encode_slice(&[flags, service], &mut advertised)?;
    let name = AdStructure::CompleteLocalName(name.as_bytes());
    let name_length = AdStructure::encode_slice(&[name], &mut response)?;
    let advertisement = Advertisement::ConnectableScannableUndirected {
        adv_data: &advertised[..length],
        scan_data: &response[..name_length],
    };
    let advertiser = peripheral.advertise(&Default::default(), advertisement).await?;
    Ok(advertiser.accept().await?.with_attribute_server(server)?)
}

/// Passes what the host writes to the node, until the connection ends. The link is connected while the host listens to
/// notifications.
async fn receive(server: &Server<'_>, connection: &Connection<'_>, link: &PacketLink) {
    let mut bytes = [0; LONGEST];
    let mut listens = false;
    loop {
        let event = match connection.next().await {
            GattConnectionEvent::Disconnected { .. } => return,
            GattConnectionEvent::Gatt { event } => event,
            _ => continue,
        };
        let reply = match event {
            GattEvent::Write(event) if event.handle() == server.uart.rx.handle => {
                let length = event.with_data(|_, data| {
                    let places = bytes.iter_mut().zip(data);
                    places.map(|(place, byte)| *place = *byte).count()
                });
                // The answer waits for the node.
                link.receive(&bytes[..length]).await;
                event.accept_unprocessed()
            }
            event => event.accept(),
        };
        if let Ok(reply) = reply {
            reply.send().await;
        }
        if listens != server.uart.tx.should_notify(connection) {
            listens = !listens;
            if listens { link.connect() } else { link.disconnect() }
        }
    }
}

/// Sends what the node writes, until the connection ends.
async fn send(server: &Server<'_>, connection: &Connection<'_>, link: &PacketLink) {
    let mut bytes = [0; LONGEST];
    loop {
        let most = usize::from(connection.raw().att_mtu()).saturating_sub(ATT_HEADER);
        let length = link.next_packet(&mut bytes[..most.min(LONGEST)]).await;
        let packet = &bytes[..length];
        loop {
            let sent = server.uart.tx.notify_raw(connection, packet, false).await;
            match sent {
                Ok(()) => break,
                Err(Error::OutOfMemory) => Timer::after_millis(AGAIN_MS).await,
                // The connection has ended.
                Err(_) => return,
            }
        }
    }
}

/// A static random address of this chip.
fn address(device_id: u64) -> Address {
    let [a, b, c, d, e, f, ..] = device_id.to_le_bytes();
    // The two highest bits mark it as such.
    Address::random([a, b, c, d, e, f | 0xC0])
}

/// `wimu-` and the last four hexadecimal digits of the device id.
fn name(device_id: u64) -> [u8; 9] {
    let digit = |at: u32| match (device_id >> (4 * at) & 0xF) as u8 {
        low @ 0..10 => b'0' + low,
        high => b'a' + high - 10,
    };
    let [a, b, c, d] = [3, 2, 1, 0].map(digit);
    [b'w', b'i', b'm', b'u', b'-', a, b, c, d]
}
