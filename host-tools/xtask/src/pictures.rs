//! Drawings of wires for the boards' pages: docs/pictures/wiring-BOARD.svg.

use std::fmt::Write as _;

use crate::Result;

/// A part: its name, and the names of its pins from top to bottom.
struct Part(&'static str, &'static [&'static str]);

/// A board between a sensor on the left and an adapter on the right; each wire joins two pins by their places.
struct Wiring {
    name: &'static str,
    board: &'static str,
    sensor: Part,
    adapter: Part,
    /// Pins of the board on its left and right side; each is wired to the pin beside it. Empty: no wire.
    pins: [&'static [&'static str]; 2],
}

const ADAPTER: Part = Part("Bluetooth adapter", &["RXD", "TXD", "GND"]);

const WIRINGS: [Wiring; 5] = [
    Wiring {
        name: "pico",
        board: "Raspberry Pi Pico",
        sensor: Part("MPU-6050 (GY-521)", &["VCC", "GND", "SDA", "SCL", "INT"]),
        adapter: ADAPTER,
        pins: [&["3V3", "GND", "GP4", "GP5", "GP6"], &["GP0", "GP1", "GND"]],
    },
    Wiring {
        name: "xiao-nrf52840",
        board: "XIAO nRF52840 Sense",
        sensor: Part("", &[]),
        adapter: Part("push-button, optional", &["pin 1", "pin 2"]),
        pins: [&[], &["D0", "GND"]],
    },
    Wiring {
        name: "microbit-v2",
        board: "micro:bit v2",
        sensor: Part("", &[]),
        adapter: ADAPTER,
        pins: [&[], &["ring 0", "ring 1", "GND"]],
    },
    Wiring {
        name: "esp32c3",
        board: "ESP32-C3",
        sensor: Part("MPU-6050 (GY-521)", &["VCC", "GND", "SDA", "SCL", "INT"]),
        adapter: Part("", &[]),
        pins: [&["3V3", "GND", "GPIO6", "GPIO7", "GPIO5"], &[]],
    },
    Wiring {
        name: "stm32f411",
        board: "STM32F411 Black Pill",
        sensor: Part("LSM6DSO", &["VDD", "GND", "SDA", "SCL", "INT1"]),
        adapter: Part("USB serial adapter", &["RXD", "TXD", "GND"]),
        pins: [&["3V3", "GND", "PB7", "PB6", "PB0"], &["PA9", "PA10", "GND"]],
    },
];

/// Left edges of the three boxes, their width, and the distance of two pins, px.
const LEFT: [u32; 3] = [10, 260, 510];
const WIDTH: u32 = 160;
const PITCH: u32 = 26;
/// Supply, ground, and four signals.
const COLOURS: [(&str, &str); 2] = [("3V3", "#c0392b"), ("GND", "#444444")];
const SIGNALS: [&str; 4] = ["#2a7fb8", "#c98a00", "#2e8b57", "#8e44ad"];

/// Writes all drawings.
pub fn write() -> Result {
    for wiring in &WIRINGS {
        let path = format!("docs/pictures/wiring-{}.svg", wiring.name);
        std::fs::write(&path, wiring.svg()?)?;
        println!("{path}");
    }
    Ok(())
}

impl Wiring {
    fn svg(&self) -> Result<String> {
        let [left, right] = self.pins;
        let height = 50 + PITCH * left.len().max(right.len()) as u32;
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 680 {}\" font-family=\"sans-serif\" \
             font-size=\"13\">\n<title>Wiring of the {}</title>\n",
            height + 20,
            self.board
        );
        let boxes = [(self.sensor.0, LEFT[0]), (self.board, LEFT[1]), (self.adapter.0, LEFT[2])];
        for (name, x) in boxes.into_iter().filter(|(name, _)| !name.is_empty()) {
            writeln!(
                svg,
                "<rect x=\"{x}\" y=\"10\" width=\"{WIDTH}\" height=\"{height}\" rx=\"8\" fill=\"#f4f4ee\" \
                 stroke=\"#444\"/>\n<text x=\"{}\" y=\"30\" text-anchor=\"middle\" font-weight=\"bold\">{name}</text>",
                x + WIDTH / 2
            )?;
        }
        self.wires(&mut svg, left, self.sensor.1, [LEFT[0] + WIDTH, LEFT[1]], false)?;
        self.wires(&mut svg, right, self.adapter.1, [LEFT[1] + WIDTH, LEFT[2]], true)?;
        Ok(svg + "</svg>\n")
    }

    /// Wires between two edges; the board is on the left of them if `board_first`.
    fn wires(
        &self,
        svg: &mut String,
        board: &[&str],
        other: &[&str],
        [from, to]: [u32; 2],
        board_first: bool,
    ) -> Result {
        for (row, (pin, end)) in board.iter().zip(other).enumerate() {
            let y = 55 + PITCH * row as u32;
            let colour = COLOURS.iter().find(|(name, _)| name == pin);
            let colour = colour.map_or(SIGNALS[row % SIGNALS.len()], |(_, colour)| colour);
            let (first, second) = if board_first { (pin, end) } else { (end, pin) };
            writeln!(
                svg,
                "<path d=\"M{from} {y}H{to}\" stroke=\"{colour}\" stroke-width=\"4\"/>\n\
                 <text x=\"{}\" y=\"{}\" text-anchor=\"end\">{first}</text><text x=\"{}\" y=\"{}\">{second}</text>",
                from - 8,
                y + 4,
                to + 8,
                y + 4
            )?;
        }
        Ok(())
    }
}
