//! A camera that goes around what it looks at.
use nalgebra::{Rotation3, Unit};
use osteotome_mechanics::geometry::{Pose, Vec3};
use osteotome_render::Camera;

/// Where the camera is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orbit {
    target: Vec3,
    /// Right, up, forward.
    axes: [Vec3; 3],
    distance: f64,
    tangent: f64,
}

/// Nearest and farthest \[mm\].
const DISTANCES: [f64; 2] = [25.0, 1500.0];

impl Orbit {
    /// From a camera.
    pub fn of(camera: &Camera) -> Self {
        let vector = |v: [f32; 3]| Vec3::from(v.map(f64::from));
        let axes = camera.axes.map(vector);
        let distance = f64::from(camera.distance);
        Self {
            target: vector(camera.eye) + axes[2] * distance,
            axes,
            distance,
            tangent: f64::from(camera.tangent),
        }
    }

    /// From behind two chisels, along them: what the one sees who holds them.
    pub fn behind(tools: &[Pose; 2]) -> Self {
        let tip = 0.5 * (tools[0].translation.vector + tools[1].translation.vector);
        let drive = tools.iter().map(|t| t.rotation * Vec3::z()).sum::<Vec3>();
        let drive = drive.try_normalize(1e-9).unwrap_or(-Vec3::z());
        // Beside the shafts, or they would hide what they do.
        let above = if drive.z.abs() < 0.9 {
            Vec3::z()
        } else {
            -Vec3::y()
        };
        let aside = (above - drive * above.dot(&drive)).normalize();
        let eye = tip - drive * 140.0 + aside * 140.0;
        let f = |v: Vec3| -> [f32; 3] { v.cast::<f32>().into() };
        Self::of(&Camera::look_at(f(eye), f(tip), f(above), 26.0))
    }

    /// For the renderer.
    pub fn camera(&self) -> Camera {
        let f = |v: Vec3| -> [f32; 3] { v.cast::<f32>().into() };
        Camera {
            eye: f(self.target - self.axes[2] * self.distance),
            axes: self.axes.map(f),
            tangent: self.tangent as f32,
            shift: 0.0,
            distance: self.distance as f32,
        }
    }

    /// Right, up, forward.
    pub fn axes(&self) -> &[Vec3; 3] {
        &self.axes
    }

    /// Millimetres, where it looks at, to a pixel of a picture `height` pixels high.
    pub fn mm_per_pixel(&self, height: f64) -> f64 {
        2.0 * self.distance * self.tangent / height.max(1.0)
    }

    /// Goes around: to the right and up by so many radians.
    pub fn turn(&mut self, right: f64, up: f64) {
        // Over the pole all would stand on its head.
        let elevation = (-self.axes[2].z).clamp(-1.0, 1.0).asin();
        let up = (elevation + up).clamp(-1.55, 1.55) - elevation;
        let about_z = Rotation3::from_axis_angle(&Vec3::z_axis(), right);
        let about_right = Rotation3::from_axis_angle(&Unit::new_normalize(self.axes[0]), -up);
        self.axes = self.axes.map(|a| about_z * about_right * a);
        let forward = self.axes[2].normalize();
        let right = forward.cross(&self.axes[1]).normalize();
        self.axes = [right, right.cross(&forward), forward];
    }

    /// Goes nearer (below 1) or away (above 1).
    pub fn zoom(&mut self, factor: f64) {
        self.distance = (self.distance * factor).clamp(DISTANCES[0], DISTANCES[1]);
    }

    /// Looks at another point, from as far and in the same direction.
    pub fn look_at(&mut self, target: Vec3) {
        self.target = target;
    }

    /// Moves along the picture by so many millimetres to the right and up.
    pub fn pan(&mut self, right: f64, up: f64) {
        self.target += self.axes[0] * right + self.axes[1] * up;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn going_around_keeps_the_target_in_the_middle() {
        let eye = [0.0, -300.0, 80.0];
        let camera = Camera::look_at(eye, [5.0, 10.0, 0.0], [0.0, 0.0, 1.0], 26.0);
        let mut orbit = Orbit::of(&camera);
        for k in 0..400 {
            orbit.turn(0.1, if k < 200 { 0.05 } else { -0.04 });
        }
        orbit.zoom(0.5);
        orbit.look_at(Vec3::new(5.0, 10.0, 1.0));
        let seen = orbit.camera();
        let target: Vec<f32> = (0..3)
            .map(|k| seen.eye[k] + seen.axes[2][k] * seen.distance)
            .collect();
        for (a, b) in target.iter().zip([5.0, 10.0, 1.0]) {
            assert!((a - b).abs() < 1e-3, "{target:?}");
        }
        assert!((seen.distance / camera.distance - 0.5).abs() < 1e-5);
        assert!(seen.axes[1][2] > 0.0, "the head stays up");
        (0..100).for_each(|_| orbit.zoom(0.5));
        assert_eq!(orbit.camera().distance, 25.0);
    }

    #[test]
    fn dragging_to_the_right_shows_what_was_on_the_left() {
        let camera = Camera::look_at([0.0, -100.0, 0.0], [0.0; 3], [0.0, 0.0, 1.0], 26.0);
        let mut orbit = Orbit::of(&camera);
        orbit.turn(-0.5, 0.0);
        assert!(orbit.camera().eye[0] < -10.0);
        orbit.turn(0.0, 0.5);
        assert!(orbit.camera().eye[2] > 10.0);
    }
}
