//! What is particular about the chip: clocks, priorities, reset reason.

use embassy_stm32::interrupt::{Interrupt, InterruptExt, Priority};
use embassy_stm32::time::Hertz;
use embassy_stm32::{Config, pac, rcc};
use wimu_link::hello::ResetReason;

/// Crystal of the board, Hz.
const CRYSTAL: Hertz = Hertz(25_000_000);

/// 96 MHz from the crystal.
pub fn clocks() -> Config {
    let mut config = Config::default();
    config.rcc.hse = Some(rcc::Hse { freq: CRYSTAL, mode: rcc::HseMode::Oscillator });
    config.rcc.pll_src = rcc::PllSource::HSE;
    config.rcc.pll = Some(rcc::Pll {
        prediv: rcc::PllPreDiv::DIV25,
        mul: rcc::PllMul::MUL192,
        divp: Some(rcc::PllPDiv::DIV2),
        divq: None,
        divr: None,
    });
    config.rcc.sys = rcc::Sysclk::PLL1_P;
    // At most 50 MHz.
    config.rcc.apb1_pre = rcc::APBPrescaler::DIV2;
    config
}

/// The reset reason.
pub fn reset_reason() -> ResetReason {
    let found = pac::RCC.csr().read();
    // The bits accumulate until they are cleared.
    pac::RCC.csr().modify(|flags| flags.set_rmvf(true));
    match found {
        _ if found.wdgrstf() => ResetReason::Watchdog,
        _ if found.sftrstf() => ResetReason::Software,
        _ if found.porrstf() => ResetReason::PowerOn,
        _ if found.borrstf() => ResetReason::BrownOut,
        // Set by every reset.
        _ if found.padrstf() => ResetReason::Pin,
        _ => ResetReason::Unknown,
    }
}

/// Data-ready line and bus, then the links, then the sampler. The time driver has the highest.
pub fn set_priorities() {
    for first in [
        Interrupt::EXTI0,
        Interrupt::I2C1_EV,
        Interrupt::I2C1_ER,
        Interrupt::DMA1_STREAM0,
        Interrupt::DMA1_STREAM6,
    ] {
        first.set_priority(Priority::P1);
    }
    Interrupt::USART1.set_priority(Priority::P2);
    Interrupt::USART2.set_priority(Priority::P2);
    Interrupt::SPI5.set_priority(Priority::P3);
}
