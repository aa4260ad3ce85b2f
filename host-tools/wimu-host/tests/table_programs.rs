//! Tables by the published headers of programs of which there is no real file: the values are made up.

use wimu_host::Code;
use wimu_host::formats::{self, ReadOptions, Source};
use wimu_host::recording::{Quantity, Recording, Unit};

use crate::tables::{has, named};

const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// Times of the first two rows, ns, and the first specific force, angular rate and field.
fn first(name: &str, text: &str) -> (Recording, [i64; 2], [Option<[f64; 3]>; 3]) {
    let recording = named(name, text, &ReadOptions::default())
        .unwrap_or_else(|error| panic!("{name}: {error}"));
    let vector = |quantity| {
        recording.first(quantity).and_then(|track| track.vectors().next()).map(|row| row.1)
    };
    let values =
        [Quantity::SpecificForce, Quantity::AngularRate, Quantity::MagneticField].map(vector);
    let times = recording
        .first(Quantity::SpecificForce)
        .unwrap_or_else(|| panic!("{name}: {:?}", recording.findings))
        .times_ns();
    let times = [times[0], times[1]];
    (recording, times, values)
}

fn assert_near(found: Option<[f64; 3]>, expected: [f64; 3], name: &str) {
    let found = found.unwrap_or_else(|| panic!("{name}: nothing"));
    for (a, b) in found.iter().zip(&expected) {
        assert!((a - b).abs() < 1e-9 * b.abs().max(1.0), "{name}: {found:?} {expected:?}");
    }
}

/// Name and text; times of the first rows, ns; first specific force, angular rate and magnetic field.
type Case = (&'static str, &'static str, [i64; 2], [f64; 3], Option<[f64; 3]>, Option<[f64; 3]>);

#[test]
fn tables_with_published_headers_are_read() {
    const G: f64 = 9.80665;
    let cases: &[Case] = &[
        (
            "TUM-VI data.csv",
            "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n\
             1520530308199447626,0.1,0.2,0.3,9.5,1.5,-3.5\n1520530308204447626,0.1,0.2,0.3,9.5,1.5,-3.5\n",
            [1_520_530_308_199_447_626, 1_520_530_308_204_447_626],
            [9.5, 1.5, -3.5],
            Some([0.1, 0.2, 0.3]),
            None,
        ),
        (
            "TUM-VI dso imu.txt",
            "# timestamp wx wy wz ax ay az\n1520530308199447626 0.1 0.2 0.3 9.5 0.5 -2.5\n1520530308204447626 0.1 0.2 0.3 9.5 0.5 -2.5\n",
            [1_520_530_308_199_447_626, 1_520_530_308_204_447_626],
            [9.5, 0.5, -2.5],
            None,
            None,
        ),
        (
            "rostopic.csv",
            "%time,field.header.seq,field.header.stamp,field.header.frame_id,field.orientation.x,field.orientation.y,\
             field.orientation.z,field.orientation.w,field.orientation_covariance0,field.angular_velocity.x,\
             field.angular_velocity.y,field.angular_velocity.z,field.angular_velocity_covariance0,field.linear_acceleration.x,\
             field.linear_acceleration.y,field.linear_acceleration.z,field.linear_acceleration_covariance0\n\
             1400000000000000009,1,1400000000000000001,imu,0,0,0,1,-1,0.1,0.2,0.3,0,0.5,0.25,9.75,0\n\
             1400000000010000009,2,1400000000010000001,imu,0,0,0,1,-1,0.1,0.2,0.3,0,0.5,0.25,9.75,0\n",
            [1_400_000_000_000_000_001, 1_400_000_000_010_000_001],
            [0.5, 0.25, 9.75],
            Some([0.1, 0.2, 0.3]),
            None,
        ),
        (
            "ROS 2 table.csv",
            "timestamp,orientation.x,orientation.y,orientation.z,orientation.w,angular_velocity.x,angular_velocity.y,\
             angular_velocity.z,linear_acceleration.x,linear_acceleration.y,linear_acceleration.z\n\
             1700000000.000000001,0,0,0,1,0.1,0.2,0.3,0.5,0.25,9.75\n\
             1700000000.010000001,0,0,0,1,0.1,0.2,0.3,0.5,0.25,9.75\n",
            [1_700_000_000_000_000_001, 1_700_000_000_010_000_001],
            [0.5, 0.25, 9.75],
            Some([0.1, 0.2, 0.3]),
            None,
        ),
        (
            "x-IMU3 Inertial.csv",
            "Timestamp (us),Gyroscope X (deg/s),Gyroscope Y (deg/s),Gyroscope Z (deg/s),Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g)\n\
             1000000,1,2,3,0,0.5,1\n1002500,1,2,3,0,0.5,1\n",
            [1_000_000_000, 1_002_500_000],
            [0.0, 0.5 * G, G],
            Some([DEGREE, 2.0 * DEGREE, 3.0 * DEGREE]),
            None,
        ),
        (
            "OpenLog Artemis dataLog00001.TXT",
            "rtcDate,rtcTime,aX,aY,aZ,gX,gY,gZ,mX,mY,mZ,imu_degC,output_Hz,\n\
             05/31/2024,12:30:45.12,10.74,-20.51,1000.00,1.00,2.00,3.00,10.00,20.00,30.00,25.50,0.000,\n\
             05/31/2024,12:30:45.22,10.74,-20.51,1000.00,1.00,2.00,3.00,10.00,20.00,30.00,25.50,10.000,\n",
            [1_717_158_645_120_000_000, 1_717_158_645_220_000_000],
            [10.74e-3 * G, -20.51e-3 * G, G],
            Some([DEGREE, 2.0 * DEGREE, 3.0 * DEGREE]),
            Some([1e-5, 2e-5, 3e-5]),
        ),
        (
            "Physics Toolbox.csv",
            "time;gFx;gFy;gFz;TgF;wx;wy;wz;Bx;By;Bz;\n0,005;0,1;0,2;0,97;1,0;0,01;0,02;0,03;10;20;30;\n0,015;0,1;0,2;0,97;1,0;0,01;0,02;0,03;10;20;30;\n",
            [5_000_000, 15_000_000],
            [0.1 * G, 0.2 * G, 0.97 * G],
            Some([0.01, 0.02, 0.03]),
            Some([1e-5, 2e-5, 3e-5]),
        ),
        (
            "WitMotion.csv",
            "Time,Device name,Chip Time(),Acceleration X(g),Acceleration Y(g),Acceleration Z(g),Angular velocity X(°/s),\
             Angular velocity Y(°/s),Angular velocity Z(°/s),Angle X(°),Angle Y(°),Angle Z(°),Magnetic field X(ʯt),\
             Magnetic field Y(ʯt),Magnetic field Z(ʯt),Temperature(°C),Quaternions 0(),Quaternions 1(),Quaternions 2(),Quaternions 3()\n\
             12:10:59.123,WT(c1),2024-05-31 12:30:45.120,0.5,0.25,0.75,1,2,3,4,5,6,10,20,30,25,1,0,0,0\n\
             12:10:59.223,WT(c1),2024-05-31 12:30:45.220,0.5,0.25,0.75,1,2,3,4,5,6,10,20,30,25,1,0,0,0\n",
            [1_717_158_645_120_000_000, 1_717_158_645_220_000_000],
            [0.5 * G, 0.25 * G, 0.75 * G],
            Some([DEGREE, 2.0 * DEGREE, 3.0 * DEGREE]),
            Some([1e-5, 2e-5, 3e-5]),
        ),
        (
            "WitMotion.txt",
            "StartTime: 2024-05-31 12:30:45\nTime(s)\tChipTime\tax(g)\tay(g)\taz(g)\twx(deg/s)\twy(deg/s)\twz(deg/s)\tAngleX(deg)\tAngleY(deg)\tAngleZ(deg)\tT(°)\n\
             0.100\t2024-05-31 12:30:45.120\t0.5\t0.25\t0.75\t1\t2\t3\t4\t5\t6\t25\n\
             0.200\t2024-05-31 12:30:45.220\t0.5\t0.25\t0.75\t1\t2\t3\t4\t5\t6\t25\n",
            [1_717_158_645_120_000_000, 1_717_158_645_220_000_000],
            [0.5 * G, 0.25 * G, 0.75 * G],
            Some([DEGREE, 2.0 * DEGREE, 3.0 * DEGREE]),
            None,
        ),
        (
            "MATLAB Mobile/Acceleration.csv",
            "Timestamp,X,Y,Z\n2024-05-31 12:30:45.120,0.5,0.25,9.75\n2024-05-31 12:30:45.220,0.5,0.25,9.75\n",
            [1_717_158_645_120_000_000, 1_717_158_645_220_000_000],
            [0.5, 0.25, 9.75],
            None,
            None,
        ),
        (
            "phyphox with g.csv",
            "\"Time (s)\",\"Acceleration x (m/s^2)\",\"Acceleration y (m/s^2)\",\"Acceleration z (m/s^2)\",\"Absolute acceleration (m/s^2)\"\n\
             7.5E-3,5.0E-1,2.5E-1,9.75E0,9.77E0\n1.75E-2,5.0E-1,2.5E-1,9.75E0,9.77E0\n",
            [7_500_000, 17_500_000],
            [0.5, 0.25, 9.75],
            None,
            None,
        ),
        (
            "Arduino with header.csv",
            "millis,ax,ay,az,gx,gy,gz\n100,0.01,0.02,1.00,1.5,2.5,3.5\n110,0.01,0.02,1.00,1.5,2.5,3.5\n",
            [100_000_000, 110_000_000],
            [0.01 * G, 0.02 * G, G],
            None,
            None,
        ),
        (
            "Arduino without header.txt",
            "100 0.10 0.20 9.80\n110 0.10 0.20 9.80\n120 0.10 0.20 9.80\n130 0.10 0.20 9.80\n",
            [100_000_000, 110_000_000],
            [0.1, 0.2, 9.8],
            None,
            None,
        ),
        (
            "units below.csv",
            "time\tacc_x\tacc_y\tacc_z\nms\tg\tg\tg\n100\t0.5\t0.25\t0.75\n110\t0.5\t0.25\t0.75\n",
            [100_000_000, 110_000_000],
            [0.5 * G, 0.25 * G, 0.75 * G],
            None,
            None,
        ),
        (
            "MetaWear.csv",
            "epoch (ms),time (13:00),elapsed (s),x-axis (g),y-axis (g),z-axis (g)\n\
             1700000000000,2023-11-14T22:13:20.000,0,0,0.5,1\n1700000000010,2023-11-14T22:13:20.010,0.01,0,0.5,1\n",
            [1_700_000_000_000_000_000, 1_700_000_000_010_000_000],
            [0.0, 0.5 * G, G],
            None,
            None,
        ),
        (
            "SensorLog.csv",
            "loggingTime(txt),loggingSample(N),accelerometerTimestamp_sinceReboot(s),accelerometerAccelerationX(G),\
             accelerometerAccelerationY(G),accelerometerAccelerationZ(G)\n\
             2023-11-14 23:13:20.000 +0100,1,51.2,0,0.5,1\n2023-11-14 23:13:20.010 +0100,2,51.21,0,0.5,1\n",
            [1_700_000_000_000_000_000, 1_700_000_000_010_000_000],
            [0.0, 0.5 * G, G],
            None,
            None,
        ),
    ];
    for (name, text, times, force, rate, field) in cases {
        let (_, found, values) = first(name, text);
        assert_eq!(found, *times, "{name}");
        assert_near(values[0], *force, name);
        assert_eq!(values[1].is_some(), rate.is_some(), "{name}");
        if let Some(rate) = rate {
            assert_near(values[1], *rate, name);
        }
        if let Some(field) = field {
            assert_near(values[2], *field, name);
        }
    }
}

#[test]
fn packets_of_kitti_are_read_from_a_file_or_a_folder() {
    let packet = |k: u32| {
        format!(
            "49.015 8.434 116.4 0.03 0.01 -1.2 1 2 3 4 5 0.5 0.25 9.{k} 0.5 0.25 9.8 0.01 0.02 0.03 0.01 0.02 0.03 0.1 0.02 4 11 5 5 3\n"
        )
    };
    let text: String = [5, 6, 7].map(packet).concat();
    let (recording, times, values) = first("oxts.txt", &text);
    assert!(has(&recording, Code::Rate));
    assert_eq!(times, [0, 100_000_000]);
    assert_near(values[0], [0.5, 0.25, 9.5], "oxts");
    assert_near(values[1], [0.01, 0.02, 0.03], "oxts");
    let stamps = "2011-09-26 13:02:25.964389445\n2011-09-26 13:02:26.074389445\n";
    let members = vec![
        Source::of_bytes("oxts/data/0000000000.txt", packet(5).into_bytes()),
        Source::of_bytes("oxts/data/0000000001.txt", packet(6).into_bytes()),
        Source::of_bytes("oxts/timestamps.txt", stamps.as_bytes()),
    ];
    let folder = Source::of_members("oxts", members);
    let mut recording = Recording::new("oxts");
    formats::read(&folder, &ReadOptions::default(), &mut recording).unwrap();
    let force = recording.first(Quantity::SpecificForce).unwrap();
    assert_eq!(force.info.unit, Unit::Si);
    assert_eq!(force.times_ns(), [1_317_042_145_964_389_445, 1_317_042_146_074_389_445]);
}

#[test]
fn encodings_and_units_of_spreadsheets_are_read() {
    let text = "Time (s);Accelerometer X (m/s²);Accelerometer Y (m/s²);Accelerometer Z (m/s²)\r\n0,5;0,5;0,25;9,75\r\n0,6;0,5;0,25;9,75\r\n";
    let little: Vec<u8> =
        [0xfeff].into_iter().chain(text.encode_utf16()).flat_map(u16::to_le_bytes).collect();
    let big: Vec<u8> =
        [0xfeff].into_iter().chain(text.encode_utf16()).flat_map(u16::to_be_bytes).collect();
    let latin: Vec<u8> = text.chars().map(|c| c as u8).collect();
    let marked = [&b"\xef\xbb\xbf"[..], text.as_bytes()].concat();
    for bytes in [little, big, latin, marked] {
        let source = Source::of_bytes("a.csv", bytes);
        let mut recording = Recording::new("a.csv");
        formats::read(&source, &ReadOptions::default(), &mut recording).unwrap();
        let force = recording.first(Quantity::SpecificForce).unwrap();
        assert_eq!(
            (force.len(), force.times_ns()[1], force.row(1)),
            (2, 600_000_000, Some(&[0.5, 0.25, 9.75][..]))
        );
    }
}
