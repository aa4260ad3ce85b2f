//! ROS 2 messages: definitions and CDR.

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
        "sensor_msgs/Imu",
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

/// Fields of a type, then those of each type in them, as a schema with encoding `ros2msg`.
pub fn schema(type_name: &str) -> String {
    let fields = |name: &str| {
        let known = TYPES.iter().find(|(known, _)| *known == name);
        known.map_or("", |(_, fields)| *fields)
    };
    let mut text = fields(type_name).to_owned();
    let mut parts: Vec<&str> = Vec::new();
    let mut open = vec![type_name];
    while let Some(name) = open.pop() {
        for line in fields(name).lines() {
            let part = line.split([' ', '[']).next().unwrap_or_default();
            if part.contains('/') && !parts.contains(&part) {
                parts.push(part);
                open.push(part);
            }
        }
    }
    for part in parts {
        text += &format!("{NEXT}{part}\n{}", fields(part));
    }
    text
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
