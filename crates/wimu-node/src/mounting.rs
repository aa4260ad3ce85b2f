//! Mounting of a sensor on its board.

/// An axis of a sensor, with its direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Axis {
    /// Along x.
    X,
    /// Along y.
    Y,
    /// Along z.
    Z,
    /// Against x.
    MinusX,
    /// Against y.
    MinusY,
    /// Against z.
    MinusZ,
}

impl Axis {
    const fn number(self) -> usize {
        match self {
            Self::X | Self::MinusX => 0,
            Self::Y | Self::MinusY => 1,
            Self::Z | Self::MinusZ => 2,
        }
    }

    const fn is_against(self) -> bool {
        matches!(self, Self::MinusX | Self::MinusY | Self::MinusZ)
    }
}

/// Mounting of a sensor: which of its axes lies along x, y and z of the board. Some sensors have left-handed
/// axes; the node uses right-handed ones (REP 103).
///
/// ```
/// use wimu_node::{Axis, Mounting};
///
/// /// The chip lies upside down, its x to the board's left.
/// const MOUNTING: Mounting = Mounting::new([Axis::Y, Axis::X, Axis::MinusZ]);
/// assert_eq!(MOUNTING.to_board([1, 2, 3]), [2, 1, -3]);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Mounting([Axis; 3]);

impl Mounting {
    /// The board's axes are those of the sensor.
    pub const STRAIGHT: Self = Self([Axis::X, Axis::Y, Axis::Z]);

    /// The sensor's axes along x, y and z of the board.
    ///
    /// # Panics
    /// When one of them is named twice: call it in a constant.
    pub const fn new(axes: [Axis; 3]) -> Self {
        let [x, y, z] = axes;
        assert!(
            (1 << x.number() | 1 << y.number() | 1 << z.number()) == 7,
            "each axis of the sensor must be used once"
        );
        Self(axes)
    }

    /// Converts a sample from the sensor's axes to the board's. The negative of the lowest value saturates.
    pub fn to_board(self, sensor: [i16; 3]) -> [i16; 3] {
        self.0.map(|axis| {
            let along = sensor.get(axis.number()).copied().unwrap_or_default();
            if axis.is_against() { along.saturating_neg() } else { along }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wimu_model::Counts;

    /// A micro:bit's: x to the logo, y to button A, z out of the display.
    const MICROBIT: Mounting = Mounting::new([Axis::MinusY, Axis::X, Axis::MinusZ]);

    #[test]
    fn the_side_of_a_microbit_that_is_up_is_the_axis_that_reads_one_g() {
        // What the chip puts out, and the side that is up then.
        for (chip, board) in [
            ([0, 0, -1000], [0, 0, 1000]), // display
            ([0, 0, 1000], [0, 0, -1000]),
            ([0, -1000, 0], [1000, 0, 0]), // logo
            ([0, 1000, 0], [-1000, 0, 0]),
            ([1000, 0, 0], [0, 1000, 0]), // button A
            ([-1000, 0, 0], [0, -1000, 0]),
        ] {
            assert_eq!(MICROBIT.to_board(chip), board);
            assert_eq!(Mounting::STRAIGHT.to_board(chip), chip);
        }
    }

    #[test]
    fn a_left_handed_chip_is_right_handed_on_its_board() {
        let [x, y, z] = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map(|axis| MICROBIT.to_board(axis));
        let cross = [0, 1, 2].map(|k| {
            let (a, b) = ((k + 1) % 3, (k + 2) % 3);
            x[a] * y[b] - x[b] * y[a]
        });
        assert_eq!(cross, z.map(i16::saturating_neg), "it is mirrored");
    }

    #[test]
    fn a_saturated_axis_stays_saturated() {
        let board = MICROBIT.to_board([0, i16::MIN, i16::MAX]);
        assert_eq!(board, [i16::MAX, 0, -i16::MAX]);
        assert!(Counts(board).saturated(0x7FF0));
    }
}
