//! Between two main steps the bone yields in the haptic loop as it would if the main loop were asked at once.
//!
//! Problem: a soft block on a fixed ground under the flat side of one chisel. Held against: the main loop brought to convergence
//! at the same hand, and the series of coupling K_v, contact K_c = k int j j^T dA (j = [n, r x n]) and bone C in six dimensions,
//! (1 + K_c (K_v^-1 + C))^-1 K_c. That a patch moves as a rigid body costs some per cent: hence 10 %.
mod support;

use nalgebra::{Matrix3, Matrix6, Rotation3, UnitQuaternion, Vector6};
use osteotome_mechanics::bone::{Supports, TetMaterial};
use osteotome_mechanics::contact::boundary_points;
use osteotome_mechanics::crack::growth::GrowthLengths;
use osteotome_mechanics::crack::{CrackSurface, Solid};
use osteotome_mechanics::geometry::{Aabb, Pose, TetLocator, Vec3, block_mesh};
use osteotome_mechanics::step::haptic::{
    DeviceLimits, HapticInput, HapticModel, HapticOutput, HapticState, haptic_step,
};
use osteotome_mechanics::step::main::{MainInput, MainSettings, MainState, main_step};
use osteotome_mechanics::step::{Body, Bone, Region};
use osteotome_mechanics::tool::{ScratchLimits, SolveSettings};
use std::sync::Arc;
use support::{aside, model};

fn soft_block() -> Bone {
    let (min, max) = (Vec3::new(-20.0, -12.0, -20.0), Vec3::new(20.0, 12.0, 0.0));
    let mesh = block_mesh(min, max, [10, 6, 5]);
    let fixed = (0u32..)
        .zip(mesh.nodes())
        .filter(|(_, p)| p.z < min.z + 1e-9);
    let supports = Supports {
        fixed: fixed.map(|f| f.0).collect(),
        ..Default::default()
    };
    let solid = Solid {
        locator: TetLocator::new(&mesh),
        materials: vec![TetMaterial::isotropic(60.0, 0.3, 1e9); mesh.tets().len()],
        lengths: GrowthLengths::for_element_size(mesh.mean_edge_length()),
        supports,
        mesh,
    };
    let body = Body {
        surface: boundary_points(&solid.mesh, 12),
        ends: [vec![0], vec![1]],
        region: Region(Arc::new(Aabb { min, max })),
        wall_density: 10.0,
        solid: Arc::new(solid),
    };
    Bone::new(Arc::new(body), CrackSurface::default()).unwrap()
}

struct Rig {
    bone: Bone,
    haptic: HapticModel,
    main: MainState,
    hand: HapticState,
}

/// The blade lies across the block, its side `depth` \[mm\] below the top.
fn pressed(depth: f64) -> Pose {
    let axes = [-Vec3::x(), Vec3::z(), Vec3::y()];
    let turn = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&axes));
    Pose::from_parts(
        Vec3::new(-8.0, 20.0, 1.5 - depth).into(),
        UnitQuaternion::from_rotation_matrix(&turn),
    )
}

/// The flat side on the block: 10 mm by the block's 24, pressed along z with 500 N/mm a mm2, about the tool's origin.
fn contact_stiffness() -> Matrix6<f64> {
    let (n_x, n_y) = (50, 120);
    let mut k = Matrix6::zeros();
    for i in 0..n_x {
        for j in 0..n_y {
            let x = 10.0 * ((f64::from(i) + 0.5) / f64::from(n_x) - 0.5);
            let y = 24.0 * ((f64::from(j) + 0.5) / f64::from(n_y) - 0.5) - 20.0;
            let turn = Vec3::new(x, y, -1.5).cross(&Vec3::z());
            let way = Vector6::new(0.0, 0.0, 1.0, turn.x, turn.y, turn.z);
            k += way * way.transpose() * (500.0 * 240.0 / f64::from(n_x * n_y));
        }
    }
    k
}

impl Rig {
    fn new() -> Self {
        let bone = soft_block();
        let limits = DeviceLimits {
            force_scale: 0.005,
            torque_scale: 0.01,
            max_force: 8.5,
            max_torque: 188.0,
            max_force_rate: 1e6,
            max_torque_rate: 1e9,
        };
        let start = [pressed(-0.2), aside()];
        let n_ids = bone.points.len();
        Self {
            haptic: HapticModel {
                tools: model(0.0),
                settings: SolveSettings::HAPTIC,
                limits: [limits; 2],
            },
            main: MainState::new(&bone, n_ids, ScratchLimits::default()),
            hand: HapticState::new(start, n_ids, ScratchLimits::default()),
            bone,
        }
    }

    fn haptic(&mut self, devices: [Pose; 2], yields: bool) -> HapticOutput {
        let compliance = self.main.compliance.as_ref().filter(|_| yields);
        let input = HapticInput {
            scene: self.main.scene(&self.bone),
            compliance,
            devices,
            dt: 1e-3,
        };
        haptic_step(&self.haptic, &mut self.hand, &input)
    }

    /// Main steps at these hands until nothing moves any more; the vertical pull at the first hand \[N\].
    fn settle(&mut self, devices: [Pose; 2]) -> f64 {
        let settings = MainSettings {
            absolute_tolerance: 1e-6,
            relative_tolerance: 1e-6,
            max_iterations: 40,
            ..Default::default()
        };
        let mut tools = *self.hand.tools();
        let mut pull = 0.0;
        for _ in 0..6 {
            let input = MainInput { devices, tools };
            let tools_model = &self.haptic.tools;
            let report = main_step(&self.bone, tools_model, &settings, &mut self.main, &input);
            assert!(report.converged, "residual {}", report.residual);
            (tools, pull) = (report.tools, report.wrenches[0].force.z);
        }
        pull
    }

    /// Both loops together, the first hand going down to `depth` \[mm\], so that friction has the same history in both.
    fn approach(&mut self, depth: f64) {
        for main_step in 1..=20 {
            let devices = [pressed(depth * f64::from(main_step) / 20.0), aside()];
            self.settle(devices);
            self.still(devices, true);
        }
    }

    fn still(&mut self, devices: [Pose; 2], yields: bool) -> f64 {
        let mut pull = 0.0;
        for _ in 0..12 {
            pull = self.haptic(devices, yields).bone[0].force.z;
        }
        pull
    }
}

#[test]
fn the_haptic_loop_feels_coupling_contact_and_bone_in_series() {
    let mut rig = Rig::new();
    let (before, after) = ([pressed(0.4), aside()], [pressed(0.5), aside()]);
    rig.approach(0.4);
    let settled = rig.settle(before);
    let at_rest = rig.still(before, true);
    assert!(
        (at_rest - settled).abs() < 0.01 * settled,
        "{at_rest} N in the haptic loop, {settled} N in the main loop"
    );
    let rise = |f: f64| (f - settled) / 0.1;
    let soft = rise(rig.still(after, true));
    let stiff = rise(rig.still(after, false));
    let bone = rig.main.compliance.unwrap().matrix;
    let bone: Matrix6<f64> = bone.fixed_view::<6, 6>(0, 0).into();
    let spring = Vector6::new(160.0, 160.0, 160.0, 12_000.0, 12_000.0, 12_000.0);
    let coupling = Matrix6::from_diagonal(&spring.map(f64::recip));
    let contact = contact_stiffness();
    let series = Matrix6::identity() + contact * (coupling + bone);
    let series = (series.try_inverse().unwrap() * contact)[(2, 2)];
    let truth = rise(rig.settle(after));
    assert!(
        (soft - truth).abs() < 0.1 * truth,
        "{soft} against {truth} N/mm"
    );
    assert!(
        (soft - series).abs() < 0.1 * series,
        "{soft} against {series} N/mm"
    );
    assert!(
        stiff > 1.15 * truth,
        "a bone that stands still: {stiff} against {truth} N/mm; too hard a block for this test"
    );
}

#[test]
fn force_follows_the_hand_at_every_step_and_hands_do_not_mix() {
    let mut rig = Rig::new();
    rig.approach(0.4);
    let mut last = 0.0;
    for step in 0..20 {
        let depth = 0.4 + 0.004 * f64::from(step);
        let output = rig.haptic([pressed(depth), aside()], true);
        let [pull, other] = output.device.map(|w| w.force.norm());
        assert!(pull > last, "step {step}: {pull} after {last} N");
        assert!(other == 0.0, "the other hand feels {other} N");
        last = pull;
    }
}
