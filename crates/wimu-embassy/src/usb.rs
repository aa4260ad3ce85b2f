//! The cable as a USB serial port (CDC ACM).

use embassy_futures::join::join4;
use embassy_usb::class::cdc_acm::{CdcAcmClass, State};
use embassy_usb::driver::Driver;
use embassy_usb::{Builder, Config};

use crate::PacketLink;

/// Longest packet of a full-speed bulk endpoint, bytes.
const PACKET: usize = 64;
/// Longest packet sent: a full one would have to be followed by an empty one.
const SENT: usize = PACKET - 1;

/// Memory of [`run_usb`].
#[derive(Default)]
pub struct UsbMemory {
    configuration: Descriptor,
    bos: Descriptor,
    control: Descriptor,
    serial: [u8; 16],
    state: State<'static>,
}

/// Memory of a descriptor, or of a control transfer: the descriptor of a CDC ACM device takes 75 bytes.
struct Descriptor([u8; 128]);

impl Default for Descriptor {
    fn default() -> Self {
        Self([0; 128])
    }
}

/// What a host sees of the USB device.
#[derive(Clone, Copy, Debug)]
pub struct UsbIdentity {
    /// Numbers of vendor and product.
    pub numbers: (u16, u16),
    /// Name of the product.
    pub product: &'static str,
    /// Serial number, shown in hexadecimal.
    pub device_id: u64,
}

/// Runs a USB serial port between `driver` and `link`: the body of a task. The link is connected while a host has the port
/// open (DTR).
pub async fn run_usb(
    driver: impl Driver<'static>,
    memory: &'static mut UsbMemory,
    identity: UsbIdentity,
    link: &PacketLink,
) -> ! {
    let UsbMemory { configuration, bos, control, serial, state } = memory;
    for (place, digit) in serial.iter_mut().rev().zip(0..) {
        let value = (identity.device_id >> (4 * digit) & 0xF) as u8;
        *place = if value < 10 { b'0' + value } else { b'A' + value - 10 };
    }
    let mut config = Config::new(identity.numbers.0, identity.numbers.1);
    config.manufacturer = Some("wimu");
    config.product = Some(identity.product);
    config.serial_number = core::str::from_utf8(serial).ok();
    let mut builder =
        Builder::new(driver, config, &mut configuration.0, &mut bos.0, &mut [], &mut control.0);
    let class = CdcAcmClass::new(&mut builder, state, PACKET as u16);
    let mut device = builder.build();
    let (mut sender, mut receiver, lines) = class.split_with_control();
    let open = async {
        let mut is_open = false;
        loop {
            lines.control_changed().await;
            if is_open == lines.dtr() {
                continue;
            }
            is_open = !is_open;
            if is_open { link.connect() } else { link.disconnect() }
        }
    };
    let send = async {
        let mut bytes = [0; SENT];
        loop {
            let length = link.next_packet(&mut bytes).await;
            let packet = bytes.get(..length).unwrap_or_default();
            if sender.write_packet(packet).await.is_err() {
                // The cable was pulled.
                link.disconnect();
                sender.wait_connection().await;
            }
        }
    };
    let receive = async {
        let mut bytes = [0; PACKET];
        loop {
            receiver.wait_connection().await;
            while let Ok(length) = receiver.read_packet(&mut bytes).await {
                link.receive(bytes.get(..length).unwrap_or_default()).await;
            }
        }
    };
    join4(device.run(), open, send, receive).await.0
}

/// Defines a module `cable` whose `start(spawner, driver, device_id)` runs the USB socket, of `$driver`, as the cable and
/// returns its halves. `$numbers` are those of vendor and product. Call it once.
#[macro_export]
macro_rules! usb_cable {
    ($driver:ty, $numbers:expr, $product:expr) => {
        /// The USB socket as the cable.
        mod cable {
            use super::*;

            pub type Reader = $crate::PacketReader<'static>;
            pub type Writer = $crate::PacketWriter<'static>;

            static LINK: $crate::PacketLink = $crate::PacketLink::new();

            #[$crate::embassy_executor::task(embassy_executor = $crate::embassy_executor)]
            async fn run(
                driver: $driver,
                memory: &'static mut $crate::UsbMemory,
                device_id: u64,
            ) -> ! {
                let (numbers, product) = ($numbers, $product);
                let identity = $crate::UsbIdentity { numbers, product, device_id };
                $crate::run_usb(driver, memory, identity, &LINK).await
            }

            pub fn start(
                spawner: $crate::embassy_executor::Spawner,
                driver: $driver,
                device_id: u64,
            ) -> (Reader, Writer) {
                static MEMORY: ::static_cell::StaticCell<$crate::UsbMemory> =
                    ::static_cell::StaticCell::new();
                let memory = MEMORY.init_with(Default::default);
                spawner.spawn(run(driver, memory, device_id).unwrap());
                LINK.split()
            }
        }
    };
}
