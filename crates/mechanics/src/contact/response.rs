use super::{Anchors, Contact, ContactScene, Matrix6, Vector6, Wrench};
use crate::geometry::{Pose, Vec3};
use nalgebra::Matrix3;

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
    /// symmetric; flat sides are taken to stay flat under a point.
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
    for contact in contacts {
        let share = Share::of(contact, law, anchors.get(contact.id));
        contact.friction = [0, 1, 2].map(|k| share.friction[k] as f32);
        contact.anchor = [0, 1, 2].map(|k| share.anchor[k] as f32);
        sum.add(&share);
    }
    sum.in_world(world_from_tool)
}

/// The part of one contact, in the tool's frame.
struct Share {
    position: Vec3,
    gradient: Vec3,
    /// k A \[N/mm\]
    stiffness: f64,
    depth: f64,
    /// On the bone.
    friction: Vec3,
    anchor: Vec3,
    /// Tangential stiffness along and across the way from the anchor \[N/mm\], and its direction.
    tangent: Option<Tangent>,
}

struct Tangent {
    normal: Vec3,
    slide: Vec3,
    along: f64,
    across: f64,
}

impl Share {
    fn of(contact: &Contact, law: &ContactLaw, anchor: Option<[f32; 3]>) -> Self {
        let position = to_f64(contact.position);
        let gradient = to_f64(contact.gradient);
        let area = f64::from(contact.area);
        let mut share = Self {
            position,
            gradient,
            stiffness: law.stiffness * area,
            depth: f64::from(contact.depth),
            friction: Vec3::zeros(),
            anchor: position,
            tangent: None,
        };
        if let Some(anchor) = anchor {
            share.cling(&to_f64(anchor), law, law.tangential_stiffness * area);
        }
        share
    }

    /// Ties the point to its anchor with a spring of `spring` \[N/mm\].
    fn cling(&mut self, anchor: &Vec3, law: &ContactLaw, spring: f64) {
        self.anchor = *anchor;
        let steepness = self.gradient.norm();
        if steepness < 1e-3 {
            return;
        }
        let normal = self.gradient / steepness;
        let way = self.position - anchor;
        let slip = way - normal * normal.dot(&way);
        let length = slip.norm();
        let limit = law.friction * self.stiffness * self.depth * steepness;
        let sticks = spring * length <= limit;
        let scale = if sticks { spring } else { limit / length };
        self.friction = -slip * scale;
        if !sticks {
            self.anchor = self.position - slip * (scale / spring);
        }
        self.tangent = Some(Tangent {
            normal,
            slide: if length > 0.0 { slip / length } else { slip },
            along: if sticks { spring } else { 0.0 },
            across: scale,
        });
    }

    /// Of the penalty, on the bone.
    fn normal_force(&self) -> Vec3 {
        self.gradient * (self.stiffness * self.depth)
    }
}

/// Sums in the tool's frame.
struct Sum {
    normal: Vector6,
    friction: Vector6,
    energy: f64,
    stiffness: Matrix6,
    /// `sum f r^T` with f the force on the tool.
    virial: Matrix3<f64>,
}

impl Default for Sum {
    fn default() -> Self {
        Self {
            normal: Vector6::zeros(),
            friction: Vector6::zeros(),
            energy: 0.0,
            stiffness: Matrix6::zeros(),
            virial: Matrix3::zeros(),
        }
    }
}

impl Sum {
    fn add(&mut self, share: &Share) {
        let normal = -share.normal_force();
        let friction = -share.friction;
        let r = share.position;
        self.normal += with_moment(&r, &normal);
        self.friction += with_moment(&r, &friction);
        self.energy += 0.5 * share.stiffness * share.depth * share.depth;
        self.virial += (normal + friction) * r.transpose();
        self.stiffen(share.stiffness, &with_moment(&r, &share.gradient));
        if let Some(t) = &share.tangent {
            self.stiffen_tangent(t, &r);
        }
    }

    fn stiffen_tangent(&mut self, t: &Tangent, r: &Vec3) {
        // Across in every tangential direction, the difference to `along` taken off along the slide.
        let (u, v) = tangents(&t.normal);
        self.stiffen(t.across, &with_moment(r, &u));
        self.stiffen(t.across, &with_moment(r, &v));
        self.stiffen(t.along - t.across, &with_moment(r, &t.slide));
    }

    /// Adds `k j j^T` to the upper triangle.
    fn stiffen(&mut self, k: f64, j: &Vector6) {
        if k == 0.0 {
            return;
        }
        for column in 0..6 {
            let kj = k * j[column];
            for row in 0..=column {
                self.stiffness[(row, column)] += kj * j[row];
            }
        }
    }

    fn in_world(mut self, world_from_tool: &Pose) -> Response {
        self.stiffness.fill_lower_triangle_with_upper_triangle();
        self.turn_with_tool();
        let turn = *world_from_tool.rotation.to_rotation_matrix().matrix();
        let mut both = Matrix6::zeros();
        both.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
        both.fixed_view_mut::<3, 3>(3, 3).copy_from(&turn);
        Response {
            normal: Wrench::from_vector(&(both * self.normal)),
            friction: Wrench::from_vector(&(both * self.friction)),
            energy: self.energy,
            stiffness: both * self.stiffness * both.transpose(),
        }
    }

    /// The forces turn with the tool, and their levers shorten as it comes: with `df = w x f`, `dr = -u` the torque
    /// `r x f` changes by `-u x f + r x (w x f)`. Subtracted, since `stiffness` is minus the derivative.
    fn turn_with_tool(&mut self) {
        let f: Vec3 = (self.normal + self.friction).fixed_rows::<3>(0).into();
        let cross = f.cross_matrix();
        let virial = 0.5 * (self.virial + self.virial.transpose());
        let turn = Matrix3::from_diagonal_element(self.virial.trace()) - virial;
        let mut add = |row, column, block: &Matrix3<f64>| {
            let mut view = self.stiffness.fixed_view_mut::<3, 3>(row, column);
            view += block;
        };
        add(0, 3, &cross);
        add(3, 0, &-cross);
        add(3, 3, &-turn);
    }
}

/// Two unit vectors that make a frame with a unit `normal`.
fn tangents(normal: &Vec3) -> (Vec3, Vec3) {
    let mut axis = Vec3::zeros();
    axis[normal.iamin()] = 1.0;
    let u = normal.cross(&axis).normalize();
    (u, normal.cross(&u))
}

fn with_moment(r: &Vec3, f: &Vec3) -> Vector6 {
    let t = r.cross(f);
    Vector6::new(f.x, f.y, f.z, t.x, t.y, t.z)
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
