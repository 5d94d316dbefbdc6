//! The scene at any time of a session.
use super::anchored::{Anchor, Skin, drawn_cells, moved_cells, piece_of, tet_at};
use super::bone_skin::{BoneSkin, Places, bone_skin};
use super::crack_skin::{GapSkin, broken_sheets, gap_skin, kerf_skin};
use super::props::{Prop, chisel, load};
use super::restore::Restored;
use super::{look, views::View};
use crate::engine::Prepared;
use crate::scenario::{Eyes, Scenario};
use crate::session::{BoneSample, GrowthSample, HandSample, Recording};
use anyhow::{Context, Result, bail};
use osteotome_mechanics::crack::CrackedBody;
use osteotome_mechanics::geometry::Vec3;
use osteotome_mechanics::tool::{Chisel, ChiselParameters};
use osteotome_render::skin::{MovedCell, Part, Skin as Drawn};
use osteotome_render::{Kind, Scene};
use std::borrow::Borrow;
use std::sync::Arc;

/// A recorded session ready to be looked at.
pub struct Stage<'a> {
    scenery: Scenery<'a>,
    recording: &'a Recording,
}

/// A patient's bone, ready to be shown in any state of any session.
pub struct Scenery<'a> {
    prepared: &'a Prepared,
    scenario: &'a Scenario,
    chisels: [Chisel; 2],
    places: Places,
    restored: Restored,
    /// The generation last shown.
    shown: Option<Shown>,
}

/// A generation's skins.
struct Shown {
    generation: usize,
    skins: Skins,
    /// The same for the renderer; pictures of a moment may outlive the generation.
    drawn: Arc<[Drawn]>,
}

/// What is to be shown of a session.
#[derive(Clone, Copy)]
pub struct Instant<'a> {
    /// When \[s\].
    pub time: f64,
    /// The bone's state; `None`: sawn and at rest.
    pub bone: Option<&'a BoneSample>,
    /// Both hands.
    pub hands: [&'a HandSample; 2],
    /// How far fragments are taken apart along the mean normal of their broken faces, all but the largest \[mm\].
    pub apart: f64,
    /// Whether arrows show the loads.
    pub shows_loads: bool,
}

/// All that moves with the bone, of one generation.
pub struct Skins {
    /// The bone's surface.
    pub bone: BoneSkin,
    kerf: Skin,
    /// The opened crack.
    pub gap: GapSkin,
    /// The explicit crack where the bone broke.
    pub broken: Skin,
    /// Crowns.
    pub teeth: Skin,
}

/// What is to be seen at one moment.
pub struct Moment {
    /// When \[s\].
    pub time: f64,
    /// Load of each hand on the bone: force \[N\] and torque \[N mm\].
    pub loads: [[f64; 2]; 2],
    /// What moves with the bone, and the cells that move it.
    skins: Arc<[Drawn]>,
    cells: Vec<MovedCell>,
    /// All else.
    props: Vec<Prop>,
    /// The latest growth.
    pub growth: GrowthState,
    eyes: Eyes,
}

/// The crack in figures.
#[derive(Clone, Copy, Debug)]
pub struct GrowthState {
    /// Broken so far \[mm2\].
    pub area: f64,
    /// Whether the operated side has come off.
    pub severed: bool,
}

impl Moment {
    /// How two eyes look at it.
    pub fn eyes(&self) -> Eyes {
        self.eyes
    }

    /// For the renderer.
    pub fn scene(&self) -> Scene<'_> {
        Scene {
            skins: &self.skins,
            cells: &self.cells,
            meshes: self.props.iter().map(Prop::mesh).collect(),
            background: look::BACKGROUND,
        }
    }
}

impl<'a> Stage<'a> {
    /// From a recording and the bone built from its scenario.
    ///
    /// # Errors
    /// A recording without the bone's states, or of another bone.
    pub fn new(prepared: &'a Prepared, recording: &'a Recording) -> Result<Self> {
        if recording.bone.is_empty() {
            bail!("the bone's displacements are not recorded; record the session again");
        }
        Ok(Self {
            scenery: Scenery::new(prepared, &recording.scenario.scenario)?,
            recording,
        })
    }

    /// The recording.
    pub fn recording(&self) -> &Recording {
        self.recording
    }

    /// A view's camera.
    pub fn camera(&self, view: View, aspect: f64) -> osteotome_render::Camera {
        view.camera(self.scenery.prepared, aspect)
    }

    /// The scene at `time` \[s\], or at the session's nearest end: hands of that step, the bone as last recorded before. All
    /// fragments but the largest are moved `apart` \[mm\] along the mean normal of their broken faces.
    ///
    /// # Errors
    /// A recording that does not fit the bone.
    pub fn at(&mut self, time: f64, apart: f64) -> Result<Moment> {
        let recording = self.recording;
        let bones = &recording.bone;
        let k = bones.partition_point(|b| b.time <= time + 1e-9);
        let step = (time / self.scenery.scenario.loops.dt()).round().max(0.0) as usize;
        let instant = Instant {
            time,
            bone: bones.get(k.saturating_sub(1)),
            hands: recording
                .hands
                .each_ref()
                .map(|h| &h[step.min(h.len() - 1)]),
            apart,
            shows_loads: true,
        };
        self.scenery.moment(&instant, &recording.growth)
    }
}

impl<'a> Scenery<'a> {
    /// Of a session with this bone and this scenario.
    ///
    /// # Errors
    /// A chisel that mechanics refuses.
    pub fn new(prepared: &'a Prepared, scenario: &'a Scenario) -> Result<Self> {
        let blade = |i: usize| {
            let c = &scenario.tool[i].chisel;
            Chisel::new(ChiselParameters {
                width: c.width,
                thickness: c.thickness,
                bevel_deg: c.bevel_deg,
                length: c.length,
            })
        };
        let body = &prepared.bone.cracked;
        Ok(Self {
            chisels: [blade(0)?, blade(1)?],
            places: Places::new(body, &prepared.patient.surface),
            restored: Restored::new(body),
            shown: None,
            prepared,
            scenario,
        })
    }

    /// The scene at an instant; `growth[k]` led to generation `k`.
    ///
    /// # Errors
    /// A state or a growth that does not fit the bone.
    pub fn moment(
        &mut self,
        now: &Instant,
        growth: &[impl Borrow<GrowthSample>],
    ) -> Result<Moment> {
        let generation = now.bone.map_or(Ok(0), |b| usize::try_from(b.generation))?;
        self.show(generation, growth)?;
        let body = self.restored.body();
        let x = match now.bone {
            Some(bone) => unknowns(body, bone)?,
            None => vec![0.0; body.system.n()],
        };
        let shown = self.shown.as_ref().context("no bone to show")?;
        let mut moved = moved_cells(body, &x);
        if now.apart > 0.0 {
            take_apart(body, &shown.skins.gap, now.apart, &mut moved);
        }
        let mut props = Vec::new();
        let mut loads = [[0.0; 2]; 2];
        for (i, hand) in now.hands.iter().enumerate() {
            let (force, torque) = load_on_bone(hand, self.scenario, i);
            loads[i] = [force.norm(), torque.norm()];
            props.extend(chisel(&self.chisels[i], &hand.tool_pose));
            if now.shows_loads {
                props.extend(load(look::LOADS[i], &hand.tool_pose, &force, &torque));
            }
        }
        Ok(Moment {
            time: now.time,
            loads,
            skins: shown.drawn.clone(),
            cells: drawn_cells(&moved),
            props,
            growth: state_of(growth.get(generation).map(Borrow::borrow)),
            eyes: self.scenario.view,
        })
    }

    fn show(&mut self, generation: usize, growth: &[impl Borrow<GrowthSample>]) -> Result<()> {
        if self
            .shown
            .as_ref()
            .is_some_and(|s| s.generation == generation)
        {
            return Ok(());
        }
        self.restored.go_to(generation, growth)?;
        let skins = Skins::of(self.restored.body(), self.prepared, &self.places);
        self.shown = Some(Shown {
            generation,
            drawn: skins.drawn().into(),
            skins,
        });
        Ok(())
    }
}

fn unknowns(body: &CrackedBody, bone: &BoneSample) -> Result<Vec<f64>> {
    if bone.x_um.len() != body.system.n() {
        bail!(
            "the bone at {:.2} s has {} unknowns, {} are recorded",
            bone.time,
            body.system.n(),
            bone.x_um.len()
        );
    }
    Ok(bone.x_um.iter().map(|v| f64::from(*v) * 1e-3).collect())
}

/// Moves the cells of all fragments but the largest away from what they broke off.
fn take_apart(body: &CrackedBody, gap: &GapSkin, apart: f64, moved: &mut [[Vec3; 4]]) {
    let away = away(body, gap);
    for (c, nodes) in moved.iter_mut().enumerate() {
        let way = away[piece_of(body, c as u32) as usize] * apart;
        nodes.iter_mut().for_each(|p| *p += way);
    }
}

/// For each fragment a unit vector away from what it broke off; zero for the largest.
pub fn away(body: &CrackedBody, gap: &GapSkin) -> Vec<Vec3> {
    let fragment = |c: usize| piece_of(body, c as u32) as usize;
    let mut away = vec![Vec3::zeros(); body.fragments.volume_share.len()];
    for ([a, b], normal) in &gap.pieces {
        let [a, b] = [*a, *b].map(|c| fragment(c as usize));
        if a != b {
            away[b] += normal;
            away[a] -= normal;
        }
    }
    away[0] = Vec3::zeros();
    let unit = |v: &Vec3| v.try_normalize(1e-9).unwrap_or_default();
    away.iter().map(unit).collect()
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

/// What a hand does to the bone: the opposite of what its device displays, unscaled.
pub fn load_on_bone(hand: &HandSample, scenario: &Scenario, i: usize) -> (Vec3, Vec3) {
    let tool = &scenario.tool[i];
    let unscaled = |v: Vec3, scale: f64| {
        if scale > 0.0 {
            -v / scale
        } else {
            Vec3::zeros()
        }
    };
    (
        unscaled(hand.wrench.force, tool.force_scale),
        unscaled(hand.wrench.torque, tool.torque_scale),
    )
}

/// Crowns, each carried by the tetrahedron under its neck.
fn teeth(body: &CrackedBody, prepared: &Prepared) -> Skin {
    let mut skin = Skin::default();
    for tooth in &prepared.patient.teeth {
        let surface = &tooth.surface;
        let bounds = surface.bounds();
        let low = bounds.min.z + 0.15 * bounds.extent().z;
        let neck: Vec<&Vec3> = surface.vertices.iter().filter(|p| p.z <= low).collect();
        let root = neck.iter().copied().sum::<Vec3>() / neck.len().max(1) as f64;
        let (tet, weights) = tet_at(body, &root);
        let cell = body.topology.cell_at(tet, &weights);
        let first = skin.anchors.len() as u32;
        for p in &surface.vertices {
            let weights = body.solid.mesh.barycentric(tet as usize, p);
            skin.push(Anchor { cell, weights }, p);
        }
        let triangles = surface.triangles.iter().map(|t| t.map(|v| v + first));
        skin.triangles.extend(triangles);
    }
    skin
}

impl Skins {
    /// Of a body.
    pub fn of(body: &CrackedBody, prepared: &Prepared, places: &Places) -> Self {
        let gap = gap_skin(body, &*prepared.bone.body.region.0);
        Self {
            bone: bone_skin(body, &prepared.patient.surface, places, &gap),
            kerf: kerf_skin(body),
            gap,
            broken: broken_sheets(body),
            teeth: teeth(body, prepared),
        }
    }

    /// For the renderer.
    fn drawn(&self) -> Vec<Drawn> {
        let (bone, gap) = (&self.bone, &self.gap);
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
            bone.skin.drawn(vec![
                smooth(Kind::Bone, look::CORTICAL, &bone.skin.triangles),
                flat(Kind::Seam, look::CORTICAL, &bone.seams),
            ]),
            self.kerf
                .drawn(vec![flat(Kind::Kerf, look::SAWN, &self.kerf.triangles)]),
            gap.drawn(vec![
                smooth(Kind::Gap, look::BROKEN, &gap.skin.triangles),
                smooth(Kind::Gap, look::SAWN, &gap.sawn),
                flat(Kind::Gap, look::BROKEN, &gap.walls),
            ]),
            self.broken.drawn(vec![flat(
                Kind::Within,
                look::CRACK,
                &self.broken.triangles,
            )]),
            self.teeth.drawn(vec![smooth(
                Kind::Solid,
                look::TOOTH,
                &self.teeth.triangles,
            )]),
        ]
    }
}
