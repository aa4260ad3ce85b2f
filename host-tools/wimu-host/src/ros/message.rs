//! ROS messages: definitions, encoding as CDR, and decoding from the serialisations of ROS 1 and ROS 2 (CDR).

use crate::recording::Quantity;

/// ROS's separator between a message's definition and those of its parts.
const NEXT: &str =
    "================================================================================\nMSG: ";

/// Types and their fields.
const TYPES: [(&str, &str); 19] = [
    ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n"),
    ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id\n"),
    ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n"),
    ("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z\n"),
    ("geometry_msgs/Quaternion", "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"),
    ("geometry_msgs/Pose", "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"),
    ("geometry_msgs/PoseStamped", "std_msgs/Header header\ngeometry_msgs/Pose pose\n"),
    ("geometry_msgs/PoseWithCovariance", "geometry_msgs/Pose pose\nfloat64[36] covariance\n"),
    ("geometry_msgs/Twist", "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n"),
    ("geometry_msgs/TwistWithCovariance", "geometry_msgs/Twist twist\nfloat64[36] covariance\n"),
    (
        "geometry_msgs/Transform",
        "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
    ),
    (
        "geometry_msgs/TransformStamped",
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n",
    ),
    ("tf2_msgs/TFMessage", "geometry_msgs/TransformStamped[] transforms\n"),
    (
        IMU,
        "std_msgs/Header header\n\
         geometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n\
         geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n\
         geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n",
    ),
    (
        "sensor_msgs/MagneticField",
        "std_msgs/Header header\ngeometry_msgs/Vector3 magnetic_field\n\
         float64[9] magnetic_field_covariance\n",
    ),
    ("sensor_msgs/Temperature", "std_msgs/Header header\nfloat64 temperature\nfloat64 variance\n"),
    (
        "nav_msgs/Odometry",
        "std_msgs/Header header\nstring child_frame_id\n\
         geometry_msgs/PoseWithCovariance pose\ngeometry_msgs/TwistWithCovariance twist\n",
    ),
    ("nav_msgs/Path", "std_msgs/Header header\ngeometry_msgs/PoseStamped[] poses\n"),
    ("std_msgs/String", "string data\n"),
];

/// Type of the messages of inertial units.
pub const IMU: &str = "sensor_msgs/Imu";

/// Types that are read, and what is in their fields.
const READ: [(&str, &[(Quantity, &str)]); 5] = [
    (
        IMU,
        &[
            (Quantity::SpecificForce, "linear_acceleration"),
            (Quantity::AngularRate, "angular_velocity"),
            (Quantity::Attitude, "orientation"),
        ],
    ),
    ("sensor_msgs/MagneticField", &[(Quantity::MagneticField, "magnetic_field")]),
    ("sensor_msgs/Temperature", &[(Quantity::Temperature, "temperature")]),
    (
        "geometry_msgs/PoseStamped",
        &[(Quantity::Position, "pose.position"), (Quantity::Attitude, "pose.orientation")],
    ),
    (
        "nav_msgs/Odometry",
        &[
            (Quantity::Position, "pose.pose.position"),
            (Quantity::Attitude, "pose.pose.orientation"),
        ],
    ),
];

/// Most bytes that a serialiser appends after the last field.
const MAX_PADDING: usize = 4;

/// Type and name of each field of a type.
fn fields(type_name: &str) -> impl Iterator<Item = (&'static str, &'static str)> + use<> {
    let found = TYPES.iter().find(|(known, _)| *known == type_name);
    found.map_or("", |(_, fields)| *fields).lines().filter_map(|line| line.split_once(' '))
}

/// Fields of a type, then those of each type in them, as a schema with encoding `ros2msg`.
pub fn schema(type_name: &str) -> String {
    let text = |name: &str| fields(name).map(|(kind, name)| format!("{kind} {name}\n"));
    let mut schema: String = text(type_name).collect();
    let mut parts: Vec<&str> = Vec::new();
    let mut open = vec![type_name];
    while let Some(name) = open.pop() {
        for (kind, _) in fields(name) {
            let part = kind.split('[').next().unwrap_or_default();
            if part.contains('/') && !parts.contains(&part) {
                parts.push(part);
                open.push(part);
            }
        }
    }
    for part in parts {
        schema += &format!("{NEXT}{part}\n");
        schema.extend(text(part));
    }
    schema
}

/// Serialisation of messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// Little endian, packed; the header begins with a sequence number.
    Ros1,
    /// Common data representation: the byte order is in the first four bytes, and fields are aligned to their size,
    /// relative to the byte after those four.
    Cdr,
}

/// A type that is read: a header, texts, and numbers.
pub struct Layout {
    /// Number of texts after the header.
    texts: usize,
    /// Number of `float64`.
    numbers: usize,
    pub parts: Vec<Part>,
}

/// A quantity in a message.
pub struct Part {
    pub quantity: Quantity,
    /// Index of the first number.
    at: usize,
    /// Index of its covariance, where −1 marks an absent quantity.
    covariance: Option<usize>,
}

impl Layout {
    /// That of a type, named without `/msg`; `None` if it is not read.
    pub fn of(type_name: &str) -> Option<Self> {
        let (_, read) = READ.iter().find(|(known, _)| *known == type_name)?;
        let mut names = Vec::new();
        numbers_of(type_name, "", &mut names);
        let part = |(quantity, path): &(Quantity, &str)| {
            let within = |name: &String| {
                name.strip_prefix(path).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
            };
            let covariance = format!("{path}_covariance");
            Some(Part {
                quantity: *quantity,
                at: names.iter().position(within)?,
                covariance: names.iter().position(|name| *name == covariance),
            })
        };
        Some(Self {
            texts: fields(type_name).filter(|(kind, _)| *kind == "string").count(),
            numbers: names.len(),
            parts: read.iter().filter_map(part).collect(),
        })
    }

    /// Header stamp, ns, and numbers of a message; `None` if it does not have the layout.
    pub fn decode(&self, encoding: Encoding, data: &[u8]) -> Option<(i64, Vec<f64>)> {
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
        for _ in 0..1 + self.texts {
            fields.skip_text()?;
        }
        let numbers: Option<Vec<f64>> =
            (0..self.numbers).map(|_| fields.take().map(f64::from_le_bytes)).collect();
        (fields.rest.len() <= MAX_PADDING).then_some((stamp_ns, numbers?))
    }
}

/// Paths of the `float64` of a type, in their order.
fn numbers_of(type_name: &str, path: &str, names: &mut Vec<String>) {
    for (kind, name) in fields(type_name) {
        let name = if path.is_empty() { name.to_owned() } else { format!("{path}.{name}") };
        let (kind, count) = kind.split_once('[').unwrap_or((kind, "1"));
        match count.trim_end_matches(']').parse() {
            Ok(count) if kind == "float64" => names.extend(std::iter::repeat_n(name, count)),
            _ => numbers_of(kind, &name, names),
        }
    }
}

impl Part {
    /// Its values among the numbers of a message; `None` if it is absent.
    pub fn values(&self, numbers: &[f64]) -> Option<[f64; 4]> {
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

/// Fields of a message that is decoded.
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

/// A message in little-endian CDR.
#[derive(Clone, Debug)]
pub struct Message(Vec<u8>);

impl Message {
    /// The encapsulation header, without a body.
    pub fn new() -> Self {
        Self(vec![0, 1, 0, 0])
    }

    /// Its bytes.
    pub fn bytes(&self) -> &[u8] {
        &self.0
    }

    /// Values are aligned to their size relative to the body, which begins after four bytes.
    fn align(&mut self, size: usize) {
        let body = (self.0.len() - 4).next_multiple_of(size);
        self.0.resize(body + 4, 0);
    }

    /// A length or an unsigned number.
    pub fn count(mut self, count: usize) -> Self {
        self.align(4);
        self.0.extend((count as u32).to_le_bytes());
        self
    }

    /// A string.
    pub fn text(self, text: &str) -> Self {
        let mut message = self.count(text.len() + 1);
        message.0.extend(text.as_bytes());
        message.0.push(0);
        message
    }

    /// A header: time, ns, which is cut to the range of ROS, and frame.
    pub fn header(mut self, stamp_ns: u64, frame: &str) -> Self {
        self.align(4);
        let seconds = i32::try_from(stamp_ns / 1_000_000_000).unwrap_or(i32::MAX);
        self.0.extend(seconds.to_le_bytes());
        let rest = (stamp_ns % 1_000_000_000) as usize;
        self.count(rest).text(frame)
    }

    /// Numbers of eight bytes.
    pub fn numbers(mut self, numbers: &[f64]) -> Self {
        self.align(8);
        let bytes = numbers.iter().flat_map(|number| number.to_le_bytes());
        self.0.extend(bytes);
        self
    }
}
