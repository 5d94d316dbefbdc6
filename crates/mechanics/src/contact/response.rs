use super::{Anchors, Contact, ContactScene, Matrix6, Vector6, Wrench};
use crate::geometry::{LANES, Pose, Vec3};
use nalgebra::Matrix3;
use wide::{f32x4, f64x4};

/// How hard bone and steel push and rub. Check with [`ContactLaw::new`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactLaw {
    stiffness: f64,
    tangential_stiffness: f64,
    friction: f64,
}

/// Why a contact law was refused.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum ContactLawError {
    /// The penalty stiffness is no positive number.
    #[error("contact stiffness is {0} MPa/mm; it must be a positive number (500 is usual)")]
    Stiffness(f64),
    /// The coefficient of friction is out of range.
    #[error("coefficient of friction is {0}; it must lie between 0 and 2")]
    Friction(f64),
}

impl Default for ContactLaw {
    /// 500 N/mm per mm2, friction 0.3: both assumed, not measured.
    fn default() -> Self {
        Self {
            stiffness: 500.0,
            tangential_stiffness: 250.0,
            friction: 0.3,
        }
    }
}

impl ContactLaw {
    /// `stiffness` \[N/mm per mm2 of touching area = MPa/mm\], `friction` coefficient mu.
    /// The tangential spring is half as stiff as the normal one: a choice, not a measurement.
    ///
    /// # Errors
    /// [`ContactLawError`] unless the stiffness is positive and friction within 0..2.
    pub fn new(stiffness: f64, friction: f64) -> Result<Self, ContactLawError> {
        if !(stiffness > 0.0 && stiffness.is_finite()) {
            return Err(ContactLawError::Stiffness(stiffness));
        }
        if !(0.0..=2.0).contains(&friction) {
            return Err(ContactLawError::Friction(friction));
        }
        Ok(Self {
            stiffness,
            tangential_stiffness: 0.5 * stiffness,
            friction,
        })
    }

    /// Normal penalty stiffness k \[N/mm per mm2\].
    pub fn stiffness(&self) -> f64 {
        self.stiffness
    }

    /// Coefficient of friction mu.
    pub fn friction(&self) -> f64 {
        self.friction
    }
}

/// A force of a tool on one point of the bone, ready to be spread to its nodes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointForce {
    /// The cell that carries the point.
    pub cell: u32,
    /// Shape functions of the cell's virtual nodes there.
    pub weights: [f32; 4],
    /// Deformed position \[mm\].
    pub point: Vec3,
    /// On the bone \[N\].
    pub force: Vec3,
}

/// What the contacts of one tool add up to. Wrenches on the tool, about its origin, in world axes.
#[derive(Clone, Copy, Debug)]
pub struct Response {
    /// Of the penalty: minus the gradient of `energy`.
    pub normal: Wrench,
    /// Of friction.
    pub friction: Wrench,
    /// `sum 1/2 k A d^2` over the points in touch \[N mm\].
    pub energy: f64,
    /// Minus the derivative of the whole wrench by the tool's motion (translation above rotation, about its origin),
    /// symmetric; flat sides are taken to stay flat under a point, and what slides to have half of its secant stiffness.
    pub stiffness: Matrix6,
}

impl Response {
    /// Nothing touches.
    pub const NONE: Self = Self {
        normal: Wrench::ZERO,
        friction: Wrench::ZERO,
        energy: 0.0,
        stiffness: Matrix6::from_array_storage(nalgebra::ArrayStorage([[0.0; 6]; 6])),
    };

    /// Penalty and friction together.
    pub fn total(&self) -> Wrench {
        self.normal + self.friction
    }
}

/// Sums the penalty and friction of all `contacts` of a tool, and sets their `friction` and `anchor`.
///
/// Penalty on the bone's point: `k A d grad(phi)`, so that with the energy `1/2 k A d^2` force is minus its gradient.
/// Friction on it: `-k_t A s` along the shape's surface, `s` the way from its anchor, never above `mu` times the normal
/// force; beyond that the anchor is dragged along. Anchors themselves change only when the step is committed.
pub fn respond(
    contacts: &mut [Contact],
    law: &ContactLaw,
    anchors: &Anchors,
    world_from_tool: &Pose,
) -> Response {
    let mut sum = Sum::default();
    for some in contacts.chunks_mut(LANES) {
        let four = Four::of(some, anchors);
        let rub = four.rub(law);
        sum.add(&four, &rub, law);
        rub.keep(some);
    }
    sum.in_world(world_from_tool)
}

/// Four contacts in the tool's frame; fewer at the end, then some have no area.
struct Four {
    position: [f32x4; 3],
    gradient: [f32x4; 3],
    area: f32x4,
    depth: f32x4,
    anchor: [f32x4; 3],
    /// Which have an anchor.
    tied: f32x4,
}

/// Stiffness along the way of a contact that slides, as a share of that across it. Its force does not grow with the way, but with the
/// depth, which a symmetric stiffness cannot say: with none at all a solve under friction takes up to three times as many steps.
const SLIDING: f32 = 0.5;

/// Friction of four contacts.
struct Rub {
    /// On the bone.
    force: [f32x4; 3],
    anchor: [f32x4; 3],
    normal: [f32x4; 3],
    /// Direction of the way from the anchor.
    slide: [f32x4; 3],
    /// Tangential stiffness along that and across it \[N/mm\]; nothing for those without an anchor.
    along: f32x4,
    across: f32x4,
}

impl Four {
    fn of(contacts: &[Contact], anchors: &Anchors) -> Self {
        // A contact's numbers in threes of four, those of four contacts then turned into lanes.
        let mut rows = [[f32x4::ZERO; LANES]; 3];
        for (k, c) in contacts.iter().enumerate().take(LANES) {
            let anchor = anchors.get(c.id);
            let [px, py, pz] = c.position;
            let [gx, gy, gz] = c.gradient;
            let [ax, ay, az] = anchor.unwrap_or(c.position);
            let tied = f32::from(u8::from(anchor.is_some()));
            rows[0][k] = f32x4::new([px, py, pz, c.area]);
            rows[1][k] = f32x4::new([gx, gy, gz, c.depth]);
            rows[2][k] = f32x4::new([ax, ay, az, tied]);
        }
        let [position, gradient, anchor] = rows;
        let [px, py, pz, area] = f32x4::transpose(position);
        let [gx, gy, gz, depth] = f32x4::transpose(gradient);
        let [ax, ay, az, tied] = f32x4::transpose(anchor);
        Self {
            position: [px, py, pz],
            gradient: [gx, gy, gz],
            area,
            depth,
            anchor: [ax, ay, az],
            tied: tied.simd_gt(f32x4::ZERO),
        }
    }

    /// Ties each point to its anchor with a spring, and lets it slide where that pulls too hard.
    fn rub(&self, law: &ContactLaw) -> Rub {
        let [zero, one] = [f32x4::ZERO, f32x4::ONE];
        let steepness = dot(&self.gradient, &self.gradient).sqrt();
        let tied = self.tied & steepness.simd_ge(f32x4::splat(1e-3));
        let normal = scaled(&self.gradient, one / tied.select(steepness, one));
        let way = minus(&self.position, &self.anchor);
        let along = |v: &[f32x4; 3]| minus(v, &scaled(&normal, dot(&normal, v)));
        // Twice: of a way that is nearly all depth, rounding would leave a part along the normal.
        let slip = along(&along(&way));
        let length = dot(&slip, &slip).sqrt();
        let is_long = length.simd_gt(zero);
        let slide = scaled(&slip, one / is_long.select(length, one));
        let spring = self.area * f32x4::splat(law.tangential_stiffness as f32);
        let push = self.area * f32x4::splat(law.stiffness as f32) * self.depth;
        let limit = push * steepness * f32x4::splat(law.friction as f32);
        let slides = (spring * length).simd_gt(limit);
        let scale = slides.select(limit / is_long.select(length, one), spring);
        let across = tied.select(scale, zero);
        let dragged = minus(&self.position, &scaled(&slip, scale / spring));
        let moves = tied & slides;
        let pick = |k: usize| moves.select(dragged[k], self.anchor[k]);
        let anchor = [pick(0), pick(1), pick(2)];
        Rub {
            force: scaled(&slip, -across),
            anchor,
            normal,
            slide,
            along: slides.select(across * f32x4::splat(SLIDING), across),
            across,
        }
    }
}

impl Rub {
    fn keep(&self, contacts: &mut [Contact]) {
        let (force, anchor) = (
            self.force.map(f32x4::to_array),
            self.anchor.map(f32x4::to_array),
        );
        for (k, c) in contacts.iter_mut().enumerate() {
            c.friction = force.map(|f| f[k]);
            c.anchor = anchor.map(|a| a[k]);
        }
    }
}

fn dot(a: &[f32x4; 3], b: &[f32x4; 3]) -> f32x4 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: &[f32x4; 3], b: &[f32x4; 3]) -> [f32x4; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

fn scaled(v: &[f32x4; 3], by: f32x4) -> [f32x4; 3] {
    [v[0] * by, v[1] * by, v[2] * by]
}

fn minus(a: &[f32x4; 3], b: &[f32x4; 3]) -> [f32x4; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Sums in the tool's frame, a lane each. What decides on rest is summed in f64; stiffness only leads the way there.
#[derive(Default)]
struct Sum {
    /// Forces on the tool, then torques.
    normal: [f64x4; 6],
    friction: [f64x4; 6],
    energy: f64x4,
    stiffness: StiffnessSum,
    /// `sum f r^T` with f the force on the tool.
    virial: [[f32x4; 3]; 3],
}

/// `sum j S j^T` for the motion j of a point by the tool's, `S` its 3 x 3 stiffness, in blocks.
#[derive(Default)]
struct StiffnessSum {
    /// Of forces by translations.
    linear: [[f32x4; 3]; 3],
    /// Of torques by translations.
    mixed: [[f32x4; 3]; 3],
    /// Of torques by rotations.
    angular: [[f32x4; 3]; 3],
}

impl Sum {
    fn add(&mut self, four: &Four, rub: &Rub, law: &ContactLaw) {
        let stiffness = four.area * f32x4::splat(law.stiffness as f32);
        let push = stiffness * four.depth;
        let normal = scaled(&four.gradient, -push);
        let friction = scaled(&rub.force, -f32x4::ONE);
        let r = &four.position;
        add_moment(&mut self.normal, r, &normal);
        add_moment(&mut self.friction, r, &friction);
        self.energy += wider(f32x4::splat(0.5) * push * four.depth);
        for (i, row) in self.virial.iter_mut().enumerate() {
            for (sum, r) in row.iter_mut().zip(r) {
                *sum += (normal[i] + friction[i]) * *r;
            }
        }
        self.stiffness
            .add(r, &point_stiffness(stiffness, &four.gradient, rub));
    }

    fn in_world(self, world_from_tool: &Pose) -> Response {
        let total = |v: [f64x4; 6]| Vector6::from(v.map(f64x4::reduce_add));
        let (normal, friction) = (total(self.normal), total(self.friction));
        let mut stiffness = self.stiffness.total();
        turn_with_tool(&mut stiffness, &(normal + friction), &block(&self.virial));
        let turn = *world_from_tool.rotation.to_rotation_matrix().matrix();
        let mut both = Matrix6::zeros();
        both.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
        both.fixed_view_mut::<3, 3>(3, 3).copy_from(&turn);
        Response {
            normal: Wrench::from_vector(&(both * normal)),
            friction: Wrench::from_vector(&(both * friction)),
            energy: self.energy.reduce_add(),
            stiffness: both * stiffness * both.transpose(),
        }
    }
}

/// Of the penalty along the gradient, of friction in every tangential direction, and along the slide by the difference of both.
fn point_stiffness(stiffness: f32x4, gradient: &[f32x4; 3], rub: &Rub) -> [[f32x4; 3]; 3] {
    let (g, n, s) = (gradient, &rub.normal, &rub.slide);
    let more = rub.along - rub.across;
    let entry = |i: usize, k: usize| {
        let own = if i == k { rub.across } else { f32x4::ZERO };
        stiffness * g[i] * g[k] + (own - rub.across * n[i] * n[k]) + more * s[i] * s[k]
    };
    let (xy, xz, yz) = (entry(0, 1), entry(0, 2), entry(1, 2));
    [
        [entry(0, 0), xy, xz],
        [xy, entry(1, 1), yz],
        [xz, yz, entry(2, 2)],
    ]
}

impl StiffnessSum {
    fn add(&mut self, r: &[f32x4; 3], s: &[[f32x4; 3]; 3]) {
        // S is symmetric, so that its columns are its rows.
        let turned = [cross(r, &s[0]), cross(r, &s[1]), cross(r, &s[2])];
        for i in 0..3 {
            let mixed = [turned[0][i], turned[1][i], turned[2][i]];
            let angular = cross(r, &mixed);
            for k in 0..3 {
                self.linear[i][k] += s[i][k];
                self.mixed[i][k] += mixed[k];
                self.angular[i][k] += angular[k];
            }
        }
    }

    fn total(&self) -> Matrix6 {
        let [linear, mixed, angular] = [&self.linear, &self.mixed, &self.angular].map(block);
        let angular = 0.5 * (angular + angular.transpose());
        let mut all = Matrix6::zeros();
        all.fixed_view_mut::<3, 3>(0, 0).copy_from(&linear);
        all.fixed_view_mut::<3, 3>(3, 0).copy_from(&mixed);
        all.fixed_view_mut::<3, 3>(0, 3)
            .copy_from(&mixed.transpose());
        all.fixed_view_mut::<3, 3>(3, 3).copy_from(&angular);
        all
    }
}

/// A 3 x 3 sum over all lanes.
fn block(lanes: &[[f32x4; 3]; 3]) -> Matrix3<f64> {
    Matrix3::from_fn(|i, k| lanes[i][k].to_array().map(f64::from).iter().sum())
}

fn wider(v: f32x4) -> f64x4 {
    let [a, b, c, d] = v.to_array();
    f64x4::new([f64::from(a), f64::from(b), f64::from(c), f64::from(d)])
}

/// Adds forces and their torques.
fn add_moment(sum: &mut [f64x4; 6], r: &[f32x4; 3], force: &[f32x4; 3]) {
    let r = [wider(r[0]), wider(r[1]), wider(r[2])];
    let f = [wider(force[0]), wider(force[1]), wider(force[2])];
    let torque = [
        r[1] * f[2] - r[2] * f[1],
        r[2] * f[0] - r[0] * f[2],
        r[0] * f[1] - r[1] * f[0],
    ];
    for k in 0..3 {
        sum[k] += f[k];
        sum[3 + k] += torque[k];
    }
}

/// The forces turn with the tool, and their levers shorten as it comes: with `df = w x f`, `dr = -u` the torque
/// `r x f` changes by `-u x f + r x (w x f)`. Subtracted, since `stiffness` is minus the derivative.
fn turn_with_tool(stiffness: &mut Matrix6, wrench: &Vector6, virial: &Matrix3<f64>) {
    let f: Vec3 = wrench.fixed_rows::<3>(0).into();
    let cross = f.cross_matrix();
    let virial = 0.5 * (virial + virial.transpose());
    let turn = Matrix3::from_diagonal_element(virial.trace()) - virial;
    let mut add = |row, column, block: &Matrix3<f64>| {
        let mut view = stiffness.fixed_view_mut::<3, 3>(row, column);
        view += block;
    };
    add(0, 3, &cross);
    add(3, 0, &-cross);
    add(3, 3, &-turn);
}

fn to_f64(v: [f32; 3]) -> Vec3 {
    Vec3::from(v.map(f64::from))
}

/// The forces of a tool's contacts on the bone, appended to `forces` while there is room.
pub fn append_point_forces(
    contacts: &[Contact],
    law: &ContactLaw,
    scene: &ContactScene,
    world_from_tool: &Pose,
    forces: &mut Vec<PointForce>,
) {
    for contact in contacts {
        let Some(weights) = scene.shell.weights(contact.place as usize) else {
            continue;
        };
        if forces.len() == forces.capacity() {
            return;
        }
        let push = law.stiffness * f64::from(contact.area) * f64::from(contact.depth);
        let force = to_f64(contact.gradient) * push + to_f64(contact.friction);
        let point = nalgebra::Point3::from(to_f64(contact.position));
        forces.push(PointForce {
            cell: contact.cell,
            weights,
            point: (world_from_tool * point).coords,
            force: world_from_tool.rotation * force,
        });
    }
}
