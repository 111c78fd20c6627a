//! The shape of the vehicle in three dimensions: a sketch, not a measurement.

use foxglove::messages::{
    Color, CubePrimitive, CylinderPrimitive, Pose, Quaternion, SceneEntity, Timestamp, Vector3,
};

use super::poses::{ESTIMATED, VEHICLE};

/// The vehicle at its pose, and a translucent copy at the estimated pose.
pub(super) fn of(vehicle: &str, timestamp: Timestamp) -> Vec<SceneEntity> {
    let entity = |frame: &str, opacity: f64| SceneEntity {
        timestamp: Some(timestamp),
        frame_id: frame.into(),
        id: frame.into(),
        frame_locked: true,
        cubes: body(opacity),
        cylinders: rotors(vehicle, opacity),
        ..SceneEntity::default()
    };
    vec![entity(VEHICLE, 1.0), entity(ESTIMATED, 0.25)]
}

fn at(x: f64, y: f64, z: f64) -> Option<Pose> {
    let orientation = Some(Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 });
    Some(Pose { position: Some(Vector3 { x, y, z }), orientation })
}

/// A fuselage, with a red nose.
fn body(opacity: f64) -> Vec<CubePrimitive> {
    let cube = |x: f64, size: (f64, f64, f64), (r, g, b): (f64, f64, f64)| CubePrimitive {
        pose: at(x, 0.0, 0.0),
        size: Some(Vector3 { x: size.0, y: size.1, z: size.2 }),
        color: Some(Color { r, g, b, a: opacity }),
    };
    vec![cube(0.0, (0.3, 0.08, 0.06), (0.2, 0.25, 0.3)), cube(0.17, (0.04, 0.06, 0.05), (0.85, 0.2, 0.15))]
}

/// Four rotors on a quadrotor; else the main rotor and, upright at the end of its boom, the tail's hub.
fn rotors(vehicle: &str, opacity: f64) -> Vec<CylinderPrimitive> {
    let disc = |x: f64, y: f64, z: f64, diameter: f64| CylinderPrimitive {
        pose: at(x, y, z),
        size: Some(Vector3 { x: diameter, y: diameter, z: 0.01 }),
        bottom_scale: 1.0,
        top_scale: 1.0,
        color: Some(Color { r: 0.25, g: 0.5, b: 0.85, a: 0.6 * opacity }),
    };
    if vehicle.contains("quad") {
        return [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)]
            .map(|(x, y)| disc(0.18 * x, 0.18 * y, 0.05, 0.22))
            .into();
    }
    vec![disc(0.0, 0.0, 0.12, 0.7), disc(-0.4, 0.0, 0.05, 0.1)]
}
