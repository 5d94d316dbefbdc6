//! A mandible from a few numbers, for when there is no scan: the signed distance field of an idealised jaw.
//!
//! Frame: mm, x = patient left, y = posterior, z = superior; origin midway between the condyle centres; symmetric about x = 0 unless the chin deviates.
//! Sizes at scale 1 follow published means (ramus 31.3 wide and 44.8 high, gonial angle 124.8 degrees, bicondylar width about
//! 120, bigonial about 98, body 28-32 high and 11-14 broad). The shape between them is invented and must be shown as such.
use crate::canal::{Canal, MEAN_DIAMETER, smooth_line};
use crate::error::{AnatomyError, in_range};
use crate::landmarks::{Landmarks, SideLandmarks, cast};
use crate::osteotomy::Side;
use crate::teeth::{Crown, ToothKind};
use osteotome_mechanics::geometry::{Aabb, MeshDistance, SignedDistance, Vec3};
use serde::{Deserialize, Serialize};

/// The numbers that make a parametric mandible; all have defaults.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Parameters {
    /// Size of the whole, 0.7 to 1.3.
    pub scale: f64,
    /// Angle between lower border and posterior border of the ramus \[degrees\], 112 to 138.
    pub gonial_angle: f64,
    /// Width of the ramus \[mm at scale 1\], 26 to 38.
    pub ramus_width: f64,
    /// Thickness of the ramus \[mm at scale 1\], 6 to 11.
    pub ramus_thickness: f64,
    /// Height of the body at the chin \[mm at scale 1\], 24 to 36.
    pub body_height: f64,
    /// Breadth of the body \[mm at scale 1\], 10 to 16.
    pub body_breadth: f64,
    /// Distance between the condyle centres \[mm at scale 1\], 80 to 115.
    pub condyle_distance: f64,
    /// How far the chin deviates to the patient's left \[mm at scale 1\], -8 to 8; all before the condyles is sheared with it.
    pub chin_deviation: f64,
    /// How far the mouth is open between the incisors \[mm\], 30 to 60, with maxilla, upper teeth, lips and retractor around the jaw
    /// that tools touch ([`crate::mouth`]); 0: none of them.
    pub mouth_opening: f64,
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            scale: 1.0,
            gonial_angle: MEAN_GONIAL_ANGLE,
            ramus_width: 31.3,
            ramus_thickness: 8.0,
            body_height: 30.0,
            body_breadth: 12.5,
            condyle_distance: 101.0,
            chin_deviation: 0.0,
            mouth_opening: 0.0,
        }
    }
}

impl Parameters {
    /// Checks the ranges.
    ///
    /// # Errors
    /// [`AnatomyError::OutOfRange`] naming the first number that is outside its range.
    pub fn check(&self) -> Result<(), AnatomyError> {
        let ranges = [
            ("scale", self.scale, 0.7, 1.3),
            ("gonial_angle", self.gonial_angle, 112.0, 138.0),
            ("ramus_width", self.ramus_width, 26.0, 38.0),
            ("ramus_thickness", self.ramus_thickness, 6.0, 11.0),
            ("body_height", self.body_height, 24.0, 36.0),
            ("body_breadth", self.body_breadth, 10.0, 16.0),
            ("condyle_distance", self.condyle_distance, 80.0, 115.0),
            ("chin_deviation", self.chin_deviation, -8.0, 8.0),
        ];
        for (name, value, low, high) in ranges {
            in_range(&format!("patient.parametric.{name}"), value, low, high)?;
        }
        if self.mouth_opening == 0.0 {
            return Ok(());
        }
        let key = "patient.parametric.mouth_opening";
        in_range(key, self.mouth_opening, 30.0, 60.0)
    }
}

/// How far the posterior border leans back from the vertical at the mean gonial angle \[degrees\].
const RAMUS_LEAN: f64 = 10.8;
/// The mean gonial angle \[degrees\]; half of a deviation tilts the ramus, half the lower border.
const MEAN_GONIAL_ANGLE: f64 = 124.8;
/// Condyle: half axes across, along and up \[mm\].
const CONDYLE: Vec3 = Vec3::new(9.5, 4.5, 4.8);
/// From the chin to the gonion along y \[mm\].
const BODY_LENGTH: f64 = 62.0;
/// Height of the alveolar process \[mm\].
const ALVEOLAR_HEIGHT: f64 = 15.0;
/// Radius of the smooth unions \[mm\].
const BLEND: f64 = 4.0;
/// The same between neck and condyle and about the chin, where the bone swells gradually \[mm\].
const NECK_BLEND: f64 = 8.0;
/// The same about foramina and lingula \[mm\].
const DETAIL_BLEND: f64 = 1.2;
/// How much the condyle's inner pole is turned back \[degrees\].
const CONDYLE_TURN: f64 = 15.0;
/// Half axes of one half of the mental protuberance \[mm\].
const CHIN: Vec3 = Vec3::new(8.5, 3.5, 4.5);
/// Along the row of teeth to between the premolars, over the mental foramen \[mm at scale 1\].
const PREMOLARS: f64 = 24.5;
/// Vertices of the arch and of the ramus outline.
const N_ARCH: usize = 40;

/// The signed distance field. Exact distance only near the surface's smooth parts; its sign and zero set are exact everywhere.
#[derive(Clone, Debug)]
pub struct ParametricMandible {
    parameters: Parameters,
    /// Gonion: x, y, z.
    gonion: Vec3,
    /// Ramus frame in the y-z plane: forward (`w`) and up (`v`) along the posterior border.
    forward: [f64; 2],
    up: [f64; 2],
    /// Ramus outline in (w, v), counter-clockwise.
    outline: Vec<[f64; 2]>,
    /// Right half of the body's centre line in (x, y), from the midline back, with height of lower and upper border and half breadth.
    arch: Vec<ArchPoint>,
    /// The same of the alveolar process, which carries the teeth and runs nearer to the tongue than the body does.
    alveolar: Vec<ArchPoint>,
    /// Inclination of the lower border against the horizontal, as a slope.
    slope: f64,
    /// Both sides' crowns, right first, from the midline back.
    teeth: Vec<Crown>,
    /// Small bumps and hollows of the left side.
    details: Vec<Detail>,
}

/// An ellipsoid that is added to the bone or taken from it \[mm at scale 1\].
#[derive(Clone, Copy, Debug)]
struct Detail {
    centre: Vec3,
    half_axes: Vec3,
    is_hollow: bool,
}

#[derive(Clone, Copy, Debug)]
struct ArchPoint {
    at: [f64; 2],
    bottom: f64,
    top: f64,
    half_breadth: f64,
    /// How much narrower it is at the lower border than half way up, relatively.
    narrow: f64,
}

impl ParametricMandible {
    /// Makes the field.
    ///
    /// # Errors
    /// As [`Parameters::check`].
    pub fn new(parameters: Parameters) -> Result<Self, AnatomyError> {
        parameters.check()?;
        let lean = RAMUS_LEAN + 0.5 * (parameters.gonial_angle - MEAN_GONIAL_ANGLE);
        let (sin, cos) = lean.to_radians().sin_cos();
        let (forward, up) = ([-cos, sin], [sin, cos]);
        let slope = (parameters.gonial_angle - 90.0 - lean).to_radians().tan();
        let outline = ramus_outline(&parameters);
        // The condyle's centre is the origin of y and z; its place in the ramus frame says where the gonion is.
        let [w, v] = condyle_in_ramus(&parameters);
        let gonion = Vec3::new(
            0.5 * parameters.condyle_distance - 5.5,
            -(w * forward[0] + v * up[0]),
            -(w * forward[1] + v * up[1]),
        );
        let mut mandible = Self {
            parameters,
            gonion,
            forward,
            up,
            outline,
            arch: Vec::new(),
            alveolar: Vec::new(),
            slope,
            teeth: Vec::new(),
            details: Vec::new(),
        };
        mandible.arch = mandible.make_arch();
        mandible.alveolar = mandible.make_alveolar();
        mandible.teeth = mandible.make_teeth();
        for i in 0..mandible.teeth.len() {
            mandible.teeth[i].neck = mandible.deviated(mandible.teeth[i].neck);
        }
        mandible.details = mandible.make_details();
        Ok(mandible)
    }

    /// Crowns of both sides, right first, from the midline back; not part of this field, which is the bone's.
    pub fn teeth(&self) -> &[Crown] {
        &self.teeth
    }

    /// Where a place of the symmetric jaw \[mm\] lies in this one. Only x changes, by a share that y alone gives.
    fn deviated(&self, p: Vec3) -> Vec3 {
        p + Vec3::x() * self.deviation(p.y)
    }

    fn deviation(&self, y: f64) -> f64 {
        let scale = self.parameters.scale;
        let chin = self.gonion.y - BODY_LENGTH;
        scale * self.parameters.chin_deviation * smoothstep(0.0, chin, y / scale)
    }

    /// The numbers it was made from.
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// Signed distance of bone and crowns together, for pictures and contact \[mm\].
    pub fn signed_with_teeth(&self, p: &Vec3) -> f64 {
        let crowns = self.teeth.iter().map(|c| c.signed(p));
        crowns.fold(self.signed(p), f64::min)
    }

    /// Signed distance to the alveolar process alone, if the chin does not deviate \[mm\].
    pub(crate) fn alveolar_process(&self, p: &Vec3) -> f64 {
        let scale = self.parameters.scale;
        let p = p / scale;
        scale * Self::strip(&self.alveolar, p.x.abs(), &p)
    }

    /// What the dental arch encloses, seen from above: x, y \[mm\].
    pub(crate) fn arch_outline(&self) -> Vec<[f64; 2]> {
        let scaled = |[x, y]: [f64; 2]| [x, y].map(|c| c * self.parameters.scale);
        let left = self.alveolar.iter().map(|q| q.at);
        let right = left.clone().skip(1).map(|[x, y]| [-x, y]);
        let right: Vec<[f64; 2]> = right.collect();
        right.into_iter().rev().chain(left).map(scaled).collect()
    }

    fn make_arch(&self) -> Vec<ArchPoint> {
        let p = &self.parameters;
        let g = self.gonion;
        // From the chin's midline along the teeth into the ramus.
        let length = BODY_LENGTH;
        let control = [
            [0.0, g.y - length],
            [0.47 * g.x, g.y - length],
            [0.76 * g.x, g.y - 0.66 * length],
            [0.99 * g.x, g.y - 0.18 * length],
        ];
        let chin = g.z - self.slope * length;
        (0..=N_ARCH)
            .map(|i| {
                let t = i as f64 / N_ARCH as f64;
                let at = [0, 1].map(|k| bezier(&control.map(|c| c[k]), t));
                let back = (at[1] - g.y + length) / length;
                // Straight along the mandibular plane, levelled towards the chin.
                let bottom = chin
                    + self.slope * length * (back - 0.10 * (1.0 - back).powi(4))
                    + 1.0
                    + 3.0 * smoothstep(0.55, 0.85, back);
                let crest = self.crest(back);
                let taper = 1.0 - 0.35 * smoothstep(0.55, 0.95, back);
                ArchPoint {
                    at,
                    bottom,
                    top: bottom + (crest - bottom).max(12.0),
                    half_breadth: 0.5 * p.body_breadth * taper,
                    // The chin is thicker than the bone about the incisors' roots, behind it is the other way round.
                    narrow: 0.12 - 0.34 * (1.0 - smoothstep(0.0, 0.25, back)),
                }
            })
            .collect()
    }

    /// Height of the upper border, `back` of the way from chin to gonion: from the chin's height to that of the ramus' foot,
    /// which the chin's height moves a little.
    fn crest(&self, back: f64) -> f64 {
        let chin = self.gonion.z - self.slope * BODY_LENGTH + self.parameters.body_height;
        let foot = self.gonion.z + 11.0 + 0.6 * (self.parameters.body_height - 30.0);
        chin + (foot - chin) * back / 0.4
    }

    /// Right half of the dental arch, from the midline to behind the second molar.
    fn make_alveolar(&self) -> Vec<ArchPoint> {
        let g = self.gonion;
        let front = g.y - BODY_LENGTH;
        let control = [[0.0, 0.0], [0.40, 0.0], [0.60, 0.22], [0.78, 0.74]]
            .map(|[across, back]| [across * g.x, front + back * BODY_LENGTH]);
        let mut points: Vec<ArchPoint> = Vec::new();
        let (mut along, end) = (0.0, row_length());
        for i in 0..=N_ARCH {
            let t = i as f64 / N_ARCH as f64;
            let at = [0, 1].map(|k| bezier(&control.map(|c| c[k]), t));
            if let Some(last) = points.last() {
                along += (at[0] - last.at[0]).hypot(at[1] - last.at[1]);
            }
            let top = self.crest((at[1] - front) / BODY_LENGTH);
            points.push(ArchPoint {
                at,
                bottom: top - ALVEOLAR_HEIGHT * (1.0 - 0.4 * smoothstep(0.7 * end, end, along)),
                top,
                // Under the molars broader, behind them fading into the ramus.
                half_breadth: 3.4 + 1.2 * smoothstep(0.4 * end, 0.7 * end, along)
                    - 2.2 * smoothstep(0.85 * end, 1.05 * end, along),
                narrow: 0.0,
            });
            if along > end {
                break;
            }
        }
        points
    }

    /// Seats the crowns on the bone's crest, one beside the other along the dental arch.
    fn make_teeth(&self) -> Vec<Crown> {
        let mut along = 0.0;
        let left: Vec<Crown> = ToothKind::ROW
            .iter()
            .map(|&kind| {
                let width = kind.mean_size().mesiodistal;
                along += width;
                self.seat(kind, along - 0.5 * width)
            })
            .collect();
        let right = left.iter().map(Crown::mirrored);
        right.chain(left.iter().cloned()).collect()
    }

    fn seat(&self, kind: ToothKind, along: f64) -> Crown {
        let (at, ahead) = (self.on_arch(along), self.on_arch(along + 0.5));
        let tangent = (ahead - at).normalize();
        let outward = tangent.cross(&Vec3::z()).normalize();
        let (sin, cos) = lean(kind).to_radians().sin_cos();
        let upright = outward.cross(&tangent);
        let scale = self.parameters.scale;
        Crown {
            kind,
            is_left: true,
            neck: at * scale,
            axes: [
                tangent,
                outward * cos - upright * sin,
                upright * cos + outward * sin,
            ],
            scale,
        }
    }

    /// On the bone's crest, `along` the left dental arch from the midline \[mm at scale 1\].
    fn on_arch(&self, along: f64) -> Vec3 {
        let mut left = along;
        let mut at = self.alveolar[0];
        for pair in self.alveolar.windows(2) {
            let (a, b) = (&pair[0], &pair[1]);
            let length = (b.at[0] - a.at[0]).hypot(b.at[1] - a.at[1]);
            let s = left / length;
            let mix = |f: fn(&ArchPoint) -> f64| f(a) * (1.0 - s) + f(b) * s;
            at.at = [mix(|q| q.at[0]), mix(|q| q.at[1])];
            at.top = mix(|q| q.top);
            if s <= 1.0 {
                break;
            }
            left -= length;
        }
        // Where unions are filleted the bone stands a little higher than its parts: down onto it.
        let mut p = Vec3::new(at.at[0], at.at[1], at.top + BLEND);
        for _ in 0..40 {
            p.z -= 0.7 * self.field(&p);
        }
        p
    }

    fn ramus_frame(&self, y: f64, z: f64) -> [f64; 2] {
        let (dy, dz) = (y - self.gonion.y, z - self.gonion.z);
        [
            dy * self.forward[0] + dz * self.forward[1],
            dy * self.up[0] + dz * self.up[1],
        ]
    }

    fn out_of_ramus(&self, [w, v]: [f64; 2]) -> Vec3 {
        Vec3::new(
            self.ramus_x(w, v),
            self.gonion.y + w * self.forward[0] + v * self.up[0],
            self.gonion.z + w * self.forward[1] + v * self.up[1],
        )
    }

    /// Where the middle of the ramus is across; it leans out towards the condyle and turns in towards the tooth row.
    fn ramus_x(&self, w: f64, v: f64) -> f64 {
        let turn = (w - 20.0).max(0.0).powi(2) * (1.0 - smoothstep(0.0, 26.0, v));
        self.gonion.x + 5.5 * (v / 51.5).clamp(-0.5, 1.2) - 0.021 * turn
    }

    /// A bone along an arch.
    fn strip(arch: &[ArchPoint], x: f64, p: &Vec3) -> f64 {
        let here = [x, p.y];
        let mut best = (f64::INFINITY, 0, 0.0);
        for (i, pair) in arch.windows(2).enumerate() {
            let (a, b) = (pair[0].at, pair[1].at);
            let (e, d) = ([b[0] - a[0], b[1] - a[1]], [here[0] - a[0], here[1] - a[1]]);
            let s = ((d[0] * e[0] + d[1] * e[1]) / (e[0] * e[0] + e[1] * e[1])).clamp(0.0, 1.0);
            let distance = (d[0] - s * e[0]).powi(2) + (d[1] - s * e[1]).powi(2);
            if distance < best.0 {
                best = (distance, i, s);
            }
        }
        let (across, i, s) = (best.0.sqrt(), best.1, best.2);
        let (a, b) = (&arch[i], &arch[i + 1]);
        let mix = |f: fn(&ArchPoint) -> f64| f(a) * (1.0 - s) + f(b) * s;
        let (bottom, top) = (mix(|q| q.bottom), mix(|q| q.top));
        let (half_height, middle) = (0.5 * (top - bottom), 0.5 * (top + bottom));
        let half_breadth = mix(|q| q.half_breadth);
        let low = ((middle - p.z) / half_height).clamp(-1.0, 1.0);
        let half_breadth = half_breadth * (1.0 - mix(|q| q.narrow) * low);
        let round = (0.8 * half_breadth).min(0.8 * half_height);
        rounded(
            across - half_breadth,
            (p.z - middle).abs() - half_height,
            round,
        )
    }

    fn ramus(&self, x: f64, p: &Vec3) -> f64 {
        let [w, v] = self.ramus_frame(p.y, p.z);
        let plan = polygon_distance(&self.outline, [w, v]);
        // Thinner towards coronoid and notch, and where it fades out on the body's cheek side.
        let thin =
            (1.0 - 0.22 * smoothstep(20.0, 43.0, v)) * (1.0 - 0.5 * smoothstep(30.0, 44.0, w));
        let half = 0.5 * self.parameters.ramus_thickness * thin;
        rounded(plan, (x - self.ramus_x(w, v)).abs() - half, 0.85 * half)
    }

    fn condyle(&self, x: f64, p: &Vec3) -> f64 {
        let d = Vec3::new(x - 0.5 * self.parameters.condyle_distance, p.y, p.z);
        // The inner pole lies further back than the outer one.
        let (sin, cos) = CONDYLE_TURN.to_radians().sin_cos();
        let turned = Vec3::new(cos * d.x - sin * d.y, sin * d.x + cos * d.y, d.z);
        ellipsoid(&turned, &CONDYLE)
    }

    /// The mental protuberance, with a tubercle on either side of the midline.
    fn chin(&self, x: f64, p: &Vec3) -> f64 {
        let arch = &self.arch[0];
        let front = arch.at[1] - 0.5 * self.parameters.body_breadth;
        let centre = Vec3::new(4.5, front + 1.5, arch.bottom + 6.0);
        ellipsoid(&(Vec3::new(x, p.y, p.z) - centre), &CHIN)
    }

    fn field(&self, p: &Vec3) -> f64 {
        let x = p.x.abs();
        let body = Self::strip(&self.arch, x, p);
        let alveolar = Self::strip(&self.alveolar, x, p);
        let body = smooth_union(body, alveolar, BLEND);
        let body = smooth_union(body, self.chin(x, p), NECK_BLEND);
        let bone = smooth_union(body, self.ramus(x, p), BLEND);
        let bone = smooth_union(bone, self.condyle(x, p), NECK_BLEND);
        self.details.iter().fold(bone, |bone, detail| {
            let there = ellipsoid(&(Vec3::new(x, p.y, p.z) - detail.centre), &detail.half_axes);
            if detail.is_hollow {
                -smooth_union(-bone, there, DETAIL_BLEND)
            } else {
                smooth_union(bone, there, DETAIL_BLEND)
            }
        })
    }

    /// Mental foramen below the premolars, mandibular foramen on the inner side of the ramus, and before that the lingula.
    fn make_details(&self) -> Vec<Detail> {
        let premolars = self.on_arch(PREMOLARS);
        let nearest = self.arch.iter().min_by(|a, b| {
            let off = |q: &ArchPoint| (q.at[0] - premolars.x).hypot(q.at[1] - premolars.y);
            off(a).total_cmp(&off(b))
        });
        let arch = nearest.copied().unwrap_or(self.arch[0]);
        let middle = Vec3::new(arch.at[0], arch.at[1], 0.45 * arch.top + 0.55 * arch.bottom);
        let out = Vec3::new(middle.x, middle.y - self.gonion.y, 0.0).normalize();
        let lingula = self.lingula();
        let inner = |below: f64, behind: f64| {
            let start = lingula + Vec3::new(0.0, behind, -below);
            self.surface_from(&start, &-Vec3::x())
        };
        let foramen = Vec3::repeat(2.0);
        vec![
            Detail {
                centre: self.surface_from(&middle, &out) + out * 0.5,
                half_axes: foramen,
                is_hollow: true,
            },
            Detail {
                centre: inner(6.5, 2.0) - Vec3::x() * 0.5,
                half_axes: Vec3::new(2.0, 2.2, 3.0),
                is_hollow: true,
            },
            Detail {
                centre: inner(3.5, -1.5),
                half_axes: Vec3::new(1.3, 2.0, 3.0),
                is_hollow: false,
            },
        ]
    }

    /// The bone's surface seen from within, along a unit vector \[mm at scale 1\].
    fn surface_from(&self, start: &Vec3, direction: &Vec3) -> Vec3 {
        let mut p = *start;
        for _ in 0..40 {
            p -= direction * (0.7 * self.field(&p));
        }
        p
    }

    /// In the middle of the ramus' thickness: 53 % of its width from behind, 30 above the lower border; straight up leans forward
    /// in the ramus frame.
    fn lingula(&self) -> Vec3 {
        let (cot, w) = (self.cot(), 0.53 * self.parameters.ramus_width);
        self.out_of_ramus([w, cot * w + 30.0 * (self.up[1] - cot * self.forward[1])])
    }

    /// Landmarks of both sides on `surface`, the mesh of this field's zero set.
    ///
    /// # Errors
    /// [`AnatomyError::NotAMandible`] if `surface` is another one, so that landmarks do not fall onto it.
    pub fn landmarks(&self, surface: &MeshDistance) -> Result<Landmarks, AnatomyError> {
        let scale = self.parameters.scale;
        let chin = Vec3::new(0.0, self.arch[0].at[1], self.arch[0].bottom - 10.0) * scale;
        let chin = self.deviated(chin);
        Ok(Landmarks {
            menton: cast(surface, &chin, &Vec3::z()).ok_or_else(|| missing("menton"))?,
            right: self.side_landmarks(surface, -1.0)?,
            left: self.side_landmarks(surface, 1.0)?,
        })
    }

    fn side_landmarks(
        &self,
        surface: &MeshDistance,
        sign: f64,
    ) -> Result<SideLandmarks, AnatomyError> {
        let world =
            |p: Vec3| self.deviated(Vec3::new(sign * p.x, p.y, p.z) * self.parameters.scale);
        let onto = |p: Vec3| surface.closest(&world(p)).map_or(world(p), |c| c.point);
        let width = self.parameters.ramus_width;
        let condyle = Vec3::new(0.5 * self.parameters.condyle_distance, 0.0, 0.0);
        let crest: Vec<Vec3> = self.outline.iter().map(|q| self.out_of_ramus(*q)).collect();
        let pick = |low: f64, high: f64, up: f64| {
            let range = low * width..high * width;
            let of_crest = self.outline.iter().zip(&crest);
            of_crest
                .filter(|(q, _)| range.contains(&q[0]) && q[1] > 20.0)
                .max_by(|a, b| (up * a.1.z).total_cmp(&(up * b.1.z)))
                .map_or(condyle, |(_, p)| *p)
        };
        let lingula = self.lingula();
        let molar = self.second_molar();
        let inside = world(lingula) - Vec3::x() * (sign * 20.0);
        let below = world(molar + Vec3::new(0.0, 5.0, -60.0));
        Ok(SideLandmarks {
            condyle_centre: world(condyle),
            condyle_top: onto(condyle + Vec3::z() * CONDYLE.z),
            coronoid_tip: onto(pick(0.6, 1.2, 1.0)),
            sigmoid_notch: onto(pick(0.35, 0.8, -1.0)),
            gonion: onto(self.gonion),
            lingula: cast(surface, &inside, &(Vec3::x() * sign))
                .ok_or_else(|| missing("lingula"))?,
            external_oblique_ridge: self.ridge(&lingula, &molar).map(onto).collect(),
            second_molar_buccal: onto(molar),
            lower_border: cast(surface, &below, &Vec3::z())
                .ok_or_else(|| missing("lower border"))?,
        })
    }

    /// The canals, right and left: constructed, by published mean distances at the first molar (6.6 mm to the cheek side, 4.1 to the
    /// tongue side, 8.8 to the lower border), between this mandible's foramina.
    pub fn canals(&self) -> [Canal; 2] {
        let lingula = self.lingula();
        let foramen = self.surface_from(&(lingula + Vec3::new(0.0, 2.0, -6.5)), &-Vec3::x());
        let mut points = vec![foramen, foramen + Vec3::new(3.0, -1.0, -4.0)];
        points.extend([47.5, 38.5, 29.0].map(|along| self.canal_below(along)));
        let mental = self.canal_below(PREMOLARS);
        let out = Vec3::new(mental.x, mental.y - self.gonion.y, 0.0).normalize();
        points.push(self.surface_from(&mental, &out));
        let left = smooth_line(&points, 8);
        [Side::Right, Side::Left].map(|side| {
            let world = |p: &Vec3| {
                self.deviated(Vec3::new(side.sign() * p.x, p.y, p.z) * self.parameters.scale)
            };
            Canal {
                side,
                line: left.iter().map(world).collect(),
                radius: 0.5 * MEAN_DIAMETER * self.parameters.scale,
                is_constructed: true,
            }
        })
    }

    /// The canal's centre `along` the row of teeth \[mm at scale 1\].
    fn canal_below(&self, along: f64) -> Vec3 {
        let tooth = self.on_arch(along);
        let off = |q: &ArchPoint| (q.at[0] - tooth.x).hypot(q.at[1] - tooth.y);
        let i = (1..N_ARCH)
            .min_by(|a, b| off(&self.arch[*a]).total_cmp(&off(&self.arch[*b])))
            .unwrap_or(1);
        let (a, b) = (self.arch[i - 1].at, self.arch[i + 1].at);
        let buccal = Vec3::new(b[1] - a[1], a[0] - b[0], 0.0).normalize();
        let radius = 0.5 * MEAN_DIAMETER;
        let at = Vec3::new(
            self.arch[i].at[0],
            self.arch[i].at[1],
            self.arch[i].bottom + 8.8 + radius,
        );
        let (cheek, tongue) = (
            self.surface_from(&at, &buccal),
            self.surface_from(&at, &-buccal),
        );
        tongue.lerp(&cheek, (4.1 + radius) / (4.1 + 6.6 + 2.0 * radius))
    }

    fn cot(&self) -> f64 {
        1.0 / self.parameters.gonial_angle.to_radians().tan()
    }

    /// On the crest beside the second molar, a little forward of the ramus' front; towards the cheek.
    fn second_molar(&self) -> Vec3 {
        let y = self
            .out_of_ramus([self.parameters.ramus_width + 6.5, 5.0])
            .y;
        let nearest = self
            .arch
            .iter()
            .min_by(|a, b| (a.at[1] - y).abs().total_cmp(&(b.at[1] - y).abs()));
        let at = nearest.copied().unwrap_or(self.arch[0]);
        Vec3::new(at.at[0] + 0.9 * at.half_breadth, at.at[1], at.top - 1.5)
    }

    /// Where the ridge's cut begins above and ends before the second molar, about \[mm\].
    pub(crate) fn ridge_ends(&self, side: Side) -> [Vec3; 2] {
        let molar = self.second_molar();
        let ridge: Vec<Vec3> = self.ridge(&self.lingula(), &molar).collect();
        [ridge[0], molar]
            .map(|p| self.deviated(Vec3::new(side.sign() * p.x, p.y, p.z) * self.parameters.scale))
    }

    /// Front of the ramus from above the lingula down to the second molar, before it is brought onto the surface.
    fn ridge(&self, lingula: &Vec3, molar: &Vec3) -> impl Iterator<Item = Vec3> {
        let (top, bottom) = (lingula.z + 5.0, molar.z + 3.0);
        let mut points: Vec<Vec3> = (0..=24)
            .map(|i| top + (bottom - top) * f64::from(i) / 24.0)
            .filter_map(|z| self.ramus_front(z))
            .collect();
        let last = points.last().copied().unwrap_or(*molar);
        points.extend((1..=6).map(|i| last + (molar - last) * (f64::from(i) / 6.0)));
        points.into_iter()
    }

    /// The foremost point of the ramus' outline at a height.
    fn ramus_front(&self, z: f64) -> Option<Vec3> {
        let n = self.outline.len();
        let crossing = |i: usize| {
            let (a, b) = (self.outline[i], self.outline[(i + 1) % n]);
            let (pa, pb) = (self.out_of_ramus(a), self.out_of_ramus(b));
            let s = (z - pa.z) / (pb.z - pa.z);
            (0.0..1.0).contains(&s).then(|| pa + (pb - pa) * s)
        };
        (0..n)
            .filter_map(crossing)
            .min_by(|a, b| a.y.total_cmp(&b.y))
    }
}

fn missing(what: &str) -> AnatomyError {
    AnatomyError::NotAMandible {
        name: "the parametric mandible".to_owned(),
        reason: format!("no bone at the {what}"),
    }
}

impl SignedDistance for ParametricMandible {
    fn signed(&self, p: &Vec3) -> f64 {
        let scale = self.parameters.scale;
        let symmetric = p - Vec3::x() * self.deviation(p.y);
        scale * self.field(&(symmetric / scale))
    }

    fn bounds(&self) -> Aabb {
        let x = 0.5 * self.parameters.condyle_distance + CONDYLE.x;
        let x = x.max(self.gonion.x + self.parameters.ramus_thickness) + 3.0;
        let x = x + self.parameters.chin_deviation.abs();
        let chin = &self.arch[0];
        let top = self.outline.iter().map(|q| self.out_of_ramus(*q).z);
        Aabb {
            min: Vec3::new(
                -x,
                chin.at[1] - self.parameters.body_breadth,
                chin.bottom - 4.0,
            ),
            max: Vec3::new(x, 14.0, top.fold(CONDYLE.z, f64::max) + 4.0),
        }
        .scaled(self.parameters.scale)
    }
}

trait Scaled {
    fn scaled(self, factor: f64) -> Self;
}

impl Scaled for Aabb {
    fn scaled(self, factor: f64) -> Self {
        Self {
            min: self.min * factor,
            max: self.max * factor,
        }
    }
}

/// Length of one side's row of teeth \[mm at scale 1\].
fn row_length() -> f64 {
    let widths = ToothKind::ROW.map(|kind| kind.mean_size().mesiodistal);
    widths.iter().sum()
}

/// How far a crown leans towards lip or cheek \[degrees\]: incisors out, molars towards the tongue; invented.
fn lean(kind: ToothKind) -> f64 {
    [6.0, 6.0, 4.0, 0.0, -5.0, -10.0, -12.0][kind as usize]
}

/// Centre of the condyle in the ramus frame (w, v).
fn condyle_in_ramus(p: &Parameters) -> [f64; 2] {
    [5.0 * p.ramus_width / 31.3, 51.5]
}

/// Side view of the ramus in its frame: posterior border along w = 0, gonion at the origin.
fn ramus_outline(p: &Parameters) -> Vec<[f64; 2]> {
    let cot = 1.0 / p.gonial_angle.to_radians().tan();
    // Follows the lower border when the gonial angle differs from the one the numbers below are for.
    let tilt = |w: f64| 0.45 * w * (cot + 0.695);
    let lower = |w: f64, above: f64| [w, cot * w + above];
    let control: Vec<[f64; 2]> = [
        [0.5, 8.0],
        [0.3, 18.0],
        [0.8, 32.0],
        [0.8, 43.0],
        [1.8, 50.0],
        [5.5, 52.5],
        [8.8, 48.5],
        [10.6, 42.0],
        [14.5, 37.3],
        [18.8, 36.5],
        [23.0, 40.0],
        [26.2, 45.5],
        [28.8, 46.3],
        [31.0, 42.0],
        [31.3, 33.0],
        [30.6, 22.5],
        [31.6, 13.0 + tilt(31.6)],
        [34.5, 6.5 + tilt(34.5)],
        [39.0, 1.5 + tilt(39.0)],
        [43.0, -4.0 + tilt(43.0)],
        [43.0, -12.0 + tilt(43.0)],
        lower(36.0, 5.0),
        lower(26.0, 1.5),
        lower(15.0, 0.5),
        lower(7.5, 1.6),
        [2.4, 1.8],
    ]
    .map(|[w, v]| [w * p.ramus_width / 31.3, v])
    .to_vec();
    closed_spline(&control, 3)
}

/// Closed Catmull-Rom curve through `control`, `steps` segments between two points.
fn closed_spline(control: &[[f64; 2]], steps: usize) -> Vec<[f64; 2]> {
    let n = control.len();
    let at = |i: usize, t: f64, k: usize| {
        let [a, b, c, d] = [0, 1, 2, 3].map(|j| control[(i + j + n - 1) % n][k]);
        let cubic = (3.0 * (b - c) + d - a) * t + 2.0 * a - 5.0 * b + 4.0 * c - d;
        0.5 * (((cubic * t) + c - a) * t + 2.0 * b)
    };
    (0..n)
        .flat_map(|i| (0..steps).map(move |j| (i, j as f64 / steps as f64)))
        .map(|(i, t)| [at(i, t, 0), at(i, t, 1)])
        .collect()
}

fn bezier(c: &[f64; 4], t: f64) -> f64 {
    let s = 1.0 - t;
    c[0] * s.powi(3) + 3.0 * c[1] * s * s * t + 3.0 * c[2] * s * t * t + c[3] * t.powi(3)
}

/// 0 below `low`, 1 above `high`, smooth between.
pub(crate) fn smoothstep(low: f64, high: f64, x: f64) -> f64 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Intersection of two half spaces at distances `a` and `b`, its edge rounded with radius `r`.
pub(crate) fn rounded(a: f64, b: f64, r: f64) -> f64 {
    let (a, b) = (a + r, b + r);
    a.max(b).min(0.0) + a.max(0.0).hypot(b.max(0.0)) - r
}

/// Signed distance to an ellipsoid about the origin, near its surface.
fn ellipsoid(d: &Vec3, half_axes: &Vec3) -> f64 {
    let k0 = d.component_div(half_axes).norm();
    let k1 = d.component_div(&half_axes.component_mul(half_axes)).norm();
    if k1 < 1e-12 {
        -half_axes.min()
    } else {
        k0 * (k0 - 1.0) / k1
    }
}

/// Union with a fillet about `k` wide (polynomial smooth minimum).
pub(crate) fn smooth_union(a: f64, b: f64, k: f64) -> f64 {
    let h = (k - (a - b).abs()).max(0.0) / k;
    a.min(b) - 0.25 * k * h * h
}

/// Signed distance to a closed polygon, negative inside.
pub(crate) fn polygon_distance(polygon: &[[f64; 2]], p: [f64; 2]) -> f64 {
    let mut best = f64::INFINITY;
    let mut inside = false;
    let mut a = polygon[polygon.len() - 1];
    for &b in polygon {
        let (e, d) = ([b[0] - a[0], b[1] - a[1]], [p[0] - a[0], p[1] - a[1]]);
        let s = ((d[0] * e[0] + d[1] * e[1]) / (e[0] * e[0] + e[1] * e[1])).clamp(0.0, 1.0);
        let (dx, dy) = (d[0] - s * e[0], d[1] - s * e[1]);
        best = best.min(dx * dx + dy * dy);
        if (a[1] > p[1]) != (b[1] > p[1]) && d[0] < d[1] / e[1] * e[0] {
            inside = !inside;
        }
        a = b;
    }
    if inside { -best.sqrt() } else { best.sqrt() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesher::contour;

    fn surface(parameters: Parameters) -> (ParametricMandible, MeshDistance) {
        let mandible = ParametricMandible::new(parameters).unwrap();
        let mesh = contour(&mandible, 1.5 * parameters.scale).unwrap();
        (mandible, MeshDistance::new(mesh))
    }

    /// Sizes against the ranges of the reference sheet.
    #[test]
    fn default_jaw_has_published_sizes() {
        let (mandible, surface) = surface(Parameters::default());
        let marks = mandible.landmarks(&surface).unwrap();
        let bounds = surface.mesh().bounds();
        assert!(
            (115.0..125.0).contains(&bounds.extent().x),
            "bicondylar width"
        );
        let distance = |a: Vec3, b: Vec3| (a - b).norm();
        let bigonial = distance(marks.right.gonion, marks.left.gonion);
        assert!(
            (85.0..105.0).contains(&bigonial),
            "bigonial width {bigonial}"
        );
        let body = distance(marks.right.gonion, marks.menton);
        assert!((72.0..88.0).contains(&body), "body length {body}");
        let lingula = marks.right.lingula;
        let posterior = cast(
            &surface,
            &(lingula + Vec3::new(-2.0, 60.0, 0.0)),
            &-Vec3::y(),
        );
        let width = posterior.unwrap().y - lingula.y;
        assert!(
            (14.0..18.0).contains(&width),
            "lingula to posterior border {width}"
        );
        let below = cast(
            &surface,
            &(lingula + Vec3::new(-3.0, 0.0, -70.0)),
            &Vec3::z(),
        )
        .unwrap();
        let height = lingula.z - below.z;
        assert!(
            (27.0..34.0).contains(&height),
            "lingula to lower border {height}"
        );
        let notch = marks.right.sigmoid_notch;
        let under = Vec3::new(marks.right.gonion.x + 1.0, notch.y, -100.0);
        let height = notch.z - cast(&surface, &under, &Vec3::z()).unwrap().z;
        assert!((41.0..48.0).contains(&height), "ramus height {height}");
    }

    #[test]
    fn jaw_is_one_symmetric_piece_at_the_ends_of_all_ranges() {
        let d = Parameters::default();
        let ends = [
            Parameters {
                gonial_angle: 112.0,
                ..d
            },
            Parameters {
                gonial_angle: 138.0,
                ..d
            },
            Parameters {
                ramus_width: 26.0,
                ..d
            },
            Parameters {
                ramus_width: 38.0,
                ..d
            },
            Parameters {
                ramus_thickness: 6.0,
                ..d
            },
            Parameters {
                ramus_thickness: 11.0,
                ..d
            },
            Parameters {
                body_height: 24.0,
                body_breadth: 10.0,
                ..d
            },
            Parameters {
                body_height: 36.0,
                body_breadth: 16.0,
                ..d
            },
            Parameters {
                condyle_distance: 80.0,
                scale: 0.7,
                ..d
            },
            Parameters {
                condyle_distance: 115.0,
                scale: 1.3,
                ..d
            },
        ];
        for parameters in ends {
            let (mandible, surface) = surface(parameters);
            let closed = crate::ClosedSurface::new(surface.mesh().clone(), "jaw").unwrap();
            assert!(closed.notes.is_empty(), "{parameters:?}");
            let body = crate::mesher::Body::of(&surface);
            assert_eq!(body.genus, 0, "{parameters:?}");
            assert!(surface.mesh().bounds().min.x > mandible.bounds().min.x);
            check_teeth(&mandible, parameters);
            let marks = mandible.landmarks(&surface).unwrap();
            let (r, l) = (marks.right.lingula, marks.left.lingula);
            assert!(
                (r - Vec3::new(-l.x, l.y, l.z)).norm() < 0.3,
                "{parameters:?}"
            );
        }
    }

    /// Seated on the bone, held by it, out of it, side by side, alike on both sides.
    fn check_teeth(mandible: &ParametricMandible, parameters: Parameters) {
        let (teeth, scale) = (mandible.teeth(), parameters.scale);
        assert_eq!(teeth.len(), 14);
        for (right, left) in teeth[..7].iter().zip(&teeth[7..]) {
            assert_eq!(right.kind.fdi(false) - left.kind.fdi(true), 10);
            let mirror = Vec3::new(-left.neck.x, left.neck.y, left.neck.z);
            assert!((right.neck - mirror).norm() < 1e-12);
        }
        for (i, crown) in teeth.iter().enumerate() {
            let top = crown.neck + crown.axes[2] * (crown.kind.mean_size().height * scale);
            let heights = [crown.anchor(), crown.neck, top].map(|p| mandible.signed(&p));
            let name = format!("{:?} {parameters:?} {heights:?}", crown.kind);
            assert!(heights[0] < -1.5 * scale, "{name}");
            assert!(heights[1].abs() < 0.3 * scale, "{name}");
            assert!(heights[2] > 4.0 * scale, "{name}");
            assert!(mandible.signed_with_teeth(&(crown.neck + crown.axes[2])) < 0.0);
            // Between neighbours of one side, and at the midline, at most a touch.
            let next = match i {
                0 => &teeth[7],
                6 | 13 => continue,
                _ => &teeth[i + 1],
            };
            let contact = crown.neck * 0.5 + next.neck * 0.5 + crown.axes[2] * (5.0 * scale);
            let gap = crown.signed(&contact) + next.signed(&contact);
            assert!((-0.8..2.0).contains(&(gap / scale)), "gap {gap} {name}");
        }
    }

    #[test]
    fn scale_is_exact() {
        let large = Parameters {
            scale: 1.2,
            ..Parameters::default()
        };
        let a = ParametricMandible::new(Parameters::default()).unwrap();
        let b = ParametricMandible::new(large).unwrap();
        for p in [Vec3::new(-40.0, -20.0, -30.0), Vec3::new(3.0, -60.0, -70.0)] {
            assert!((1.2 * a.signed(&p) - b.signed(&(p * 1.2))).abs() < 1e-9);
        }
    }

    #[test]
    fn numbers_outside_their_range_are_named() {
        let wrong = Parameters {
            gonial_angle: 200.0,
            ..Parameters::default()
        };
        assert_eq!(
            ParametricMandible::new(wrong).unwrap_err().to_string(),
            "patient.parametric.gonial_angle = 200 is outside its range; it must lie between 112 and 138"
        );
    }
}
