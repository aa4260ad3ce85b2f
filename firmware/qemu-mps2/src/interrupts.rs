//! The machine's interrupts.

use cortex_m::interrupt::InterruptNumber;
use cortex_m::peripheral::NVIC;

use crate::clock;
use crate::uart::{CABLE, SENSOR_BUS, WIRELESS};

/// Interrupt numbers.
#[derive(Clone, Copy)]
enum Interrupt {
    WirelessReceive = 0,
    WirelessSent = 1,
    CableReceive = 2,
    CableSent = 3,
    SensorBusReceive = 4,
    SensorBusSent = 5,
    Timer0 = 8,
    Timer1 = 9,
}

// SAFETY: the numbers are those of the machine.
unsafe impl InterruptNumber for Interrupt {
    fn number(self) -> u16 {
        self as u16
    }
}

/// Enables the interrupts.
///
/// # Safety
/// No critical section may be under way.
pub unsafe fn unmask() {
    use Interrupt::*;
    for interrupt in [
        WirelessReceive,
        WirelessSent,
        CableReceive,
        CableSent,
        SensorBusReceive,
        SensorBusSent,
        Timer0,
        Timer1,
    ] {
        // SAFETY: the caller's.
        unsafe { NVIC::unmask(interrupt) };
    }
}

type Handler = unsafe extern "C" fn();

unsafe extern "C" {
    fn DefaultHandler();
}

#[unsafe(link_section = ".vector_table.interrupts")]
#[unsafe(no_mangle)]
static __INTERRUPTS: [Handler; 10] = [
    wireless_receive,
    wireless_sent,
    cable_receive,
    cable_sent,
    sensor_bus_receive,
    sensor_bus_sent,
    DefaultHandler,
    DefaultHandler,
    timer0,
    timer1,
];

extern "C" fn wireless_receive() {
    WIRELESS.on_receive();
}

extern "C" fn wireless_sent() {
    WIRELESS.on_sent();
}

extern "C" fn cable_receive() {
    CABLE.on_receive();
}

extern "C" fn cable_sent() {
    CABLE.on_sent();
}

extern "C" fn sensor_bus_receive() {
    SENSOR_BUS.on_receive();
}

extern "C" fn sensor_bus_sent() {
    SENSOR_BUS.on_sent();
}

extern "C" fn timer0() {
    clock::on_wrap();
}

extern "C" fn timer1() {
    clock::on_alarm();
}
