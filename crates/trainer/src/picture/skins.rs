//! The drawn surfaces of a generation of the bone, and who makes them.
use super::anchored::{Anchor, Skin, tet_at};
use super::bone_skin::{BoneSkin, Places, Slits};
use super::crack_skin::{GapSkin, KerfSkin, broken_sheets, gap_skin, kerf_skin, unparted};
use super::look;
use super::restore::Restored;
use crate::engine::Prepared;
use crate::session::GrowthSample;
use anyhow::Result;
use osteotome_mechanics::crack::CrackedBody;
use osteotome_mechanics::geometry::{TriMesh, Vec3};
use osteotome_render::Kind;
use osteotome_render::skin::{Part, Skin as Drawn};
use std::borrow::Borrow;
use std::sync::Arc;

/// All that moves with the bone, of one generation.
pub struct Skins {
    /// The bone's surface.
    pub bone: BoneSkin,
    /// The saw's slit.
    pub kerf: KerfSkin,
    /// The opened crack.
    pub gap: GapSkin,
    /// The explicit crack where the bone broke.
    pub broken: Skin,
    /// What of it has not parted fragments.
    unparted: Vec<[u32; 3]>,
    /// Crowns.
    pub teeth: Skin,
    /// Gums about their necks, over the same vertices.
    gums: Vec<[u32; 3]>,
}

/// A generation of the bone with its skins. Whoever shows it needs nothing else of the crack.
pub struct Dressed {
    /// Which.
    pub generation: usize,
    /// The bone.
    pub body: Arc<CrackedBody>,
    /// Its skins.
    pub skins: Skins,
    /// The same for the renderer; pictures of a moment may outlive the generation.
    pub drawn: Arc<[Drawn]>,
    /// Its crack.
    pub growth: GrowthState,
}

/// The crack in figures.
#[derive(Clone, Copy, Debug)]
pub struct GrowthState {
    /// Broken so far \[mm2\].
    pub area: f64,
    /// Whether the operated side has come off.
    pub severed: bool,
}

/// Makes the skins of one generation after another; of what a growth leaves alone, the slits are kept.
pub struct Skinner<'a> {
    prepared: &'a Prepared,
    places: Places,
    slits: Slits,
    restored: Restored,
    /// The last two: whoever shows the last but one and goes over to the last shall not have to free it.
    made: [Option<Arc<Dressed>>; 2],
}

impl<'a> Skinner<'a> {
    /// Of this patient's bone.
    pub fn new(prepared: &'a Prepared) -> Self {
        let body = &prepared.bone.cracked;
        Self {
            places: Places::new(body, &prepared.patient.surface),
            slits: Slits::default(),
            restored: Restored::new(body),
            made: [None, None],
            prepared,
        }
    }

    /// The sawn bone, before it breaks.
    ///
    /// # Errors
    /// None: nothing is to be repeated.
    pub fn sawn(&mut self) -> Result<Arc<Dressed>> {
        self.make(0, &[] as &[GrowthSample])
    }

    /// A generation; `growth[k]` led to generation `k`.
    ///
    /// # Errors
    /// A growth that does not fit the bone.
    pub fn make(
        &mut self,
        generation: usize,
        growth: &[impl Borrow<GrowthSample>],
    ) -> Result<Arc<Dressed>> {
        self.restored.go_to(generation, growth)?;
        let body = self.restored.shared();
        let skins = Skins::slit(&body, self.prepared, &self.places, &mut self.slits);
        let dressed = Arc::new(Dressed {
            generation,
            drawn: skins.drawn().into(),
            skins,
            body,
            growth: state_of(growth.get(generation).map(Borrow::borrow)),
        });
        let [last, _] = std::mem::take(&mut self.made);
        self.made = [Some(dressed.clone()), last];
        Ok(dressed)
    }
}

fn state_of(growth: Option<&GrowthSample>) -> GrowthState {
    growth.map_or(
        GrowthState {
            area: 0.0,
            severed: false,
        },
        |g| GrowthState {
            area: g.area,
            severed: g.severed,
        },
    )
}

/// Crowns and the gums about them, each carried by the tetrahedron under its neck.
fn teeth(body: &CrackedBody, prepared: &Prepared) -> (Skin, Vec<[u32; 3]>) {
    let (mut skin, mut gums) = (Skin::default(), Vec::new());
    for tooth in &prepared.patient.teeth {
        let surface = &tooth.surface;
        let bounds = surface.bounds();
        let low = bounds.min.z + 0.15 * bounds.extent().z;
        let neck: Vec<&Vec3> = surface.vertices.iter().filter(|p| p.z <= low).collect();
        let root = neck.iter().copied().sum::<Vec3>() / neck.len().max(1) as f64;
        let (tet, weights) = tet_at(body, &root);
        let cell = body.topology.cell_at(tet, &weights);
        let mut add = |mesh: &TriMesh| {
            let first = skin.anchors.len() as u32;
            for p in &mesh.vertices {
                let weights = body.solid.mesh.barycentric(tet as usize, p);
                skin.push(Anchor { cell, weights }, p);
            }
            let numbered = mesh.triangles.iter().map(move |t| t.map(|v| v + first));
            numbered.collect::<Vec<_>>()
        };
        let (crown, gum) = (add(surface), add(&gum(surface)));
        skin.triangles.extend(crown);
        gums.extend(gum);
    }
    (skin, gums)
}

/// A ring of gum about a crown's neck.
fn gum(crown: &TriMesh) -> TriMesh {
    /// Of the ring \[mm\].
    const THICK: f64 = 2.2;
    /// Points around, and around the ring itself.
    const AROUND: [u32; 2] = [24, 10];
    let bounds = crown.bounds();
    let extent = bounds.extent();
    let low = bounds.min.z + 0.32 * extent.z;
    let neck: Vec<&Vec3> = crown.vertices.iter().filter(|p| p.z <= low).collect();
    let middle = neck.iter().copied().sum::<Vec3>() / neck.len().max(1) as f64;
    // As far from the middle as the neck is in that direction.
    let reach = |way: &Vec3| {
        neck.iter()
            .map(|p| (*p - middle).dot(way))
            .fold(0.0, f64::max)
    };
    let turn = |k: u32, n: u32| (f64::from(k) / f64::from(n) * std::f64::consts::TAU).sin_cos();
    let mut ring = TriMesh::default();
    for i in 0..AROUND[0] {
        let (s, c) = turn(i, AROUND[0]);
        let way = Vec3::new(c, s, 0.0);
        let centre =
            Vec3::new(middle.x, middle.y, low - 0.9 * THICK) + way * (reach(&way) - 0.45 * THICK);
        for k in 0..AROUND[1] {
            let (s, c) = turn(k, AROUND[1]);
            ring.vertices
                .push(centre + (way * c + Vec3::z() * (1.25 * s)) * THICK);
        }
    }
    for i in 0..AROUND[0] {
        for k in 0..AROUND[1] {
            let at = |i: u32, k: u32| (i % AROUND[0]) * AROUND[1] + k % AROUND[1];
            let [a, b, c, d] = [at(i, k), at(i + 1, k), at(i + 1, k + 1), at(i, k + 1)];
            ring.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    ring
}

impl Skins {
    /// Of a body.
    pub fn of(body: &CrackedBody, prepared: &Prepared, places: &Places) -> Self {
        Self::slit(body, prepared, places, &mut Slits::default())
    }

    fn slit(body: &CrackedBody, prepared: &Prepared, places: &Places, slits: &mut Slits) -> Self {
        let region = &*prepared.bone.body.region.0;
        let gap = gap_skin(body, region);
        let broken = broken_sheets(body);
        let (teeth, gums) = teeth(body, prepared);
        Self {
            bone: slits.skin(body, &prepared.patient.surface, places, &gap),
            kerf: kerf_skin(body, region),
            unparted: unparted(body, &broken, &gap),
            broken,
            gap,
            teeth,
            gums,
        }
    }

    /// For the renderer.
    fn drawn(&self) -> Vec<Drawn> {
        let (bone, kerf, gap) = (&self.bone, &self.kerf, &self.gap);
        let smooth = |kind, material, triangles: &[[u32; 3]]| Part {
            kind,
            material,
            is_smooth: true,
            triangles: triangles.to_vec(),
        };
        let flat = |kind, material, triangles: &[[u32; 3]]| Part {
            is_smooth: false,
            ..smooth(kind, material, triangles)
        };
        vec![
            bone.drawn(vec![
                smooth(Kind::Bone, look::CORTICAL, &bone.skin.triangles),
                flat(Kind::Seam, look::CORTICAL, &bone.seams),
            ]),
            kerf.skin.drawn(vec![
                flat(Kind::Kerf, look::SAWN, &kerf.skin.triangles),
                flat(Kind::KerfSeam, look::SAWN, &kerf.seams),
            ]),
            gap.drawn(vec![
                smooth(Kind::Gap, look::BROKEN, &gap.skin.triangles),
                smooth(Kind::Gap, look::SAWN, &gap.sawn),
                flat(Kind::GapSeam, look::BROKEN, &gap.walls),
                flat(Kind::Within, look::CRACK, &gap.apart),
            ]),
            self.broken
                .drawn(vec![flat(Kind::Within, look::CRACK, &self.unparted)]),
            self.teeth.drawn(vec![
                smooth(Kind::Solid, look::TOOTH, &self.teeth.triangles),
                smooth(Kind::Solid, look::MUCOSA, &self.gums),
            ]),
        ]
    }
}
