//! Messages: their layouts, and decoding from the serialisations of ROS 1 and ROS 2 (CDR).

use crate::recording::Quantity;

/// Type of the messages without which a bag is refused.
pub(super) const IMU: &str = "sensor_msgs/Imu";
/// Most bytes that a serialiser appends after the last field.
const MAX_PADDING: usize = 4;

/// Serialisation of messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    /// Little endian, packed; the header begins with a sequence number.
    Ros1,
    /// Common data representation: the byte order is in the first four bytes, and fields are aligned to their size,
    /// relative to the byte after those four.
    Cdr,
}

/// A message type: a header and numbers.
pub(super) struct Kind {
    /// Without `/msg`.
    pub(super) name: &'static str,
    /// Whether a second frame's name follows the header.
    child_frame: bool,
    /// How many `float64` it has.
    numbers: usize,
    /// Its quantities, at most three.
    pub(super) parts: &'static [Part],
}

/// A quantity in a message.
pub(super) struct Part {
    pub(super) quantity: Quantity,
    /// Index of the first number.
    at: usize,
    /// Index of its covariance, where −1 marks an absent quantity.
    covariance: Option<usize>,
}

const fn part(quantity: Quantity, at: usize, covariance: Option<usize>) -> Part {
    Part { quantity, at, covariance }
}

/// The types that are read.
#[rustfmt::skip]
static KINDS: [Kind; 5] = [
    Kind { name: IMU, child_frame: false, numbers: 37, parts: &[
        part(Quantity::SpecificForce, 25, Some(28)),
        part(Quantity::AngularRate, 13, Some(16)),
        part(Quantity::Attitude, 0, Some(4)),
    ] },
    Kind { name: "sensor_msgs/MagneticField", child_frame: false, numbers: 12, parts: &[
        part(Quantity::MagneticField, 0, Some(3)),
    ] },
    Kind { name: "sensor_msgs/Temperature", child_frame: false, numbers: 2, parts: &[
        part(Quantity::Temperature, 0, None),
    ] },
    Kind { name: "geometry_msgs/PoseStamped", child_frame: false, numbers: 7, parts: &[
        part(Quantity::Position, 0, None),
        part(Quantity::Attitude, 3, None),
    ] },
    Kind { name: "nav_msgs/Odometry", child_frame: true, numbers: 85, parts: &[
        part(Quantity::Position, 0, None),
        part(Quantity::Attitude, 3, None),
    ] },
];

/// The type of this name, if it is read.
pub(super) fn kind(name: &str) -> Option<&'static Kind> {
    KINDS.iter().find(|kind| kind.name == name)
}

impl Part {
    /// Its values among the numbers of a message; `None` if it is absent.
    pub(super) fn values(&self, numbers: &[f64]) -> Option<[f64; 4]> {
        let mut values = [0.0; 4];
        let width = self.quantity.width();
        values[..width].copy_from_slice(numbers.get(self.at..self.at + width)?);
        if self.quantity == Quantity::Attitude {
            // ROS stores x, y, z, w.
            values.rotate_right(1);
        }
        let absent = (self.covariance).is_some_and(|at| numbers.get(at) == Some(&-1.0));
        let unset = self.quantity == Quantity::Attitude && values == [0.0; 4];
        (!absent && !unset).then_some(values)
    }
}

/// Header stamp, ns, and numbers of a message; `None` if it does not have the layout.
pub(super) fn decode(kind: &Kind, encoding: Encoding, data: &[u8]) -> Option<(i64, Vec<f64>)> {
    let mut fields = match (encoding, data) {
        (Encoding::Ros1, _) => Fields::new(data, false, false),
        (Encoding::Cdr, [0, order @ (0 | 1), _, _, body @ ..]) => {
            Fields::new(body, true, *order == 0)
        }
        (Encoding::Cdr, _) => return None,
    };
    if encoding == Encoding::Ros1 {
        fields.u32()?;
    }
    let seconds = fields.u32()?;
    let seconds = match encoding {
        Encoding::Ros1 => i64::from(seconds),
        Encoding::Cdr => i64::from(seconds as i32),
    };
    let stamp_ns = seconds * 1_000_000_000 + i64::from(fields.u32()?);
    for _ in 0..1 + usize::from(kind.child_frame) {
        fields.skip_text()?;
    }
    let numbers: Option<Vec<f64>> =
        (0..kind.numbers).map(|_| fields.take().map(f64::from_le_bytes)).collect();
    (fields.rest.len() <= MAX_PADDING).then_some((stamp_ns, numbers?))
}

/// Fields of a message.
struct Fields<'a> {
    rest: &'a [u8],
    length: usize,
    aligned: bool,
    big_endian: bool,
}

impl<'a> Fields<'a> {
    fn new(rest: &'a [u8], aligned: bool, big_endian: bool) -> Self {
        Self { rest, length: rest.len(), aligned, big_endian }
    }

    /// The next field of `N` bytes, little endian.
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        if self.aligned {
            let at = self.length - self.rest.len();
            self.rest = self.rest.get(at.next_multiple_of(N) - at..)?;
        }
        let (field, rest) = self.rest.split_first_chunk::<N>()?;
        self.rest = rest;
        let mut field = *field;
        if self.big_endian {
            field.reverse();
        }
        Some(field)
    }

    fn u32(&mut self) -> Option<u32> {
        self.take().map(u32::from_le_bytes)
    }

    fn skip_text(&mut self) -> Option<()> {
        let length = self.u32()?;
        self.rest = self.rest.get(usize::try_from(length).ok()?..)?;
        Some(())
    }
}
