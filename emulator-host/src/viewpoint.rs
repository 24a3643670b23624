//! A viewpoint says where a viewer is and which way it looks, as far as a sender can use that.

use codec_core::internals::wire::receipt::ViewerPose;

/// A viewer's camera: its centre, and the direction it looks in. Always finite, the direction a unit vector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Viewpoint {
    position: [f64; 3],
    forward: [f64; 3],
}

/// Length below which a quaternion says nothing about a direction.
const MIN_LENGTH: f64 = 1e-6;

impl Viewpoint {
    /// The viewpoint of `pose`, whose quaternion is normalised first; `None` if it has no direction or a
    /// number of it is not finite.
    ///
    /// # Examples
    /// ```
    /// use codec_core::internals::wire::receipt::ViewerPose;
    /// use emulator_host::Viewpoint;
    ///
    /// // Half a turn around y: the camera looks along -z.
    /// let pose = ViewerPose { position: [0.0, 0.0, 5.0], rotation: [0.0, 0.0, 1.0, 0.0] };
    /// assert_eq!(Viewpoint::of(&pose).unwrap().forward(), [0.0, 0.0, -1.0]);
    /// assert_eq!(Viewpoint::of(&ViewerPose { rotation: [0.0; 4], ..pose }), None);
    /// ```
    pub fn of(pose: &ViewerPose) -> Option<Self> {
        let position = pose.position.map(f64::from);
        let [w, x, y, z] = pose.rotation.map(f64::from);
        let length = (w * w + x * x + y * y + z * z).sqrt();
        if !(length.is_finite() && length >= MIN_LENGTH && position.iter().all(|v| v.is_finite())) {
            return None;
        }
        let [w, x, y, z] = [w, x, y, z].map(|v| v / length);
        // The third column of the rotation: cameras look along +z.
        let forward = [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)];
        Some(Self { position, forward })
    }

    /// Camera centre, scene units.
    pub fn position(&self) -> [f64; 3] {
        self.position
    }

    /// Unit vector into the picture.
    pub fn forward(&self) -> [f64; 3] {
        self.forward
    }

    /// Distance of `point`, and the angle between it and the viewing direction, radians. A point at the
    /// camera lies ahead.
    pub fn distance_and_angle(&self, point: [f64; 3]) -> (f64, f64) {
        let to: [f64; 3] = std::array::from_fn(|k| point[k] - self.position[k]);
        let distance = to.iter().map(|v| v * v).sum::<f64>().sqrt();
        let ahead: f64 = to.iter().zip(&self.forward).map(|(a, b)| a * b).sum();
        let aside = (distance * distance - ahead * ahead).max(0.0).sqrt();
        (distance, aside.atan2(ahead))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hostile_poses_have_a_finite_viewpoint_or_none() {
        let plain = ViewerPose { position: [1.0, 2.0, 3.0], rotation: [1.0, 0.0, 0.0, 0.0] };
        let at = Viewpoint::of(&plain).unwrap();
        assert_eq!((at.position(), at.forward()), ([1.0, 2.0, 3.0], [0.0, 0.0, 1.0]));
        // Any multiple of a quaternion is the same turn.
        assert_eq!(Viewpoint::of(&ViewerPose { rotation: [-1e30, 0.0, 0.0, 0.0], ..plain }), Some(at));
        let refused = [[0.0; 4], [1e-30; 4], [f32::NAN; 4], [f32::INFINITY, 0.0, 0.0, 0.0]];
        assert!(refused.iter().all(|q| Viewpoint::of(&ViewerPose { rotation: *q, ..plain }).is_none()));
        assert!(Viewpoint::of(&ViewerPose { position: [f32::NAN; 3], ..plain }).is_none());
        let far = ViewerPose { position: [f32::MAX, -f32::MAX, f32::MAX], rotation: [f32::MAX; 4] };
        let (distance, angle) = Viewpoint::of(&far).unwrap().distance_and_angle([0.0; 3]);
        assert!(distance.is_finite() && distance > 1e38 && (0.0..=3.15).contains(&angle));
    }

    #[test]
    fn angles_are_measured_from_the_viewing_direction() {
        let pose = ViewerPose { position: [0.0; 3], rotation: [1.0, 0.0, 0.0, 0.0] };
        let at = Viewpoint::of(&pose).unwrap();
        for (point, distance, degrees) in [
            ([0.0, 0.0, 2.0], 2.0, 0.0),
            ([3.0, 0.0, 3.0], 18f64.sqrt(), 45.0),
            ([0.0, -5.0, 0.0], 5.0, 90.0),
            ([0.0, 0.0, -1.0], 1.0, 180.0),
            ([0.0, 0.0, 0.0], 0.0, 0.0),
        ] {
            let found = at.distance_and_angle(point);
            assert!((found.0 - distance).abs() < 1e-12 && (found.1.to_degrees() - degrees).abs() < 1e-9);
        }
    }
}
