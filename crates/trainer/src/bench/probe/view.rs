//! What is seen: surfaces that follow the bone, and pictures of them.
use super::in_ms;
use crate::bench::rows::{Part, Row};
use crate::bench::times::{Pairs, Times};
use crate::engine::Prepared;
use crate::picture::{Dressed, Instant, Places, Scenery, Skinner, Skins, View};
use crate::scenario::Scenario;
use crate::session::{BoneSample, GrowthSample, HandSample};
use anyhow::{Result, ensure};
use osteotome_render::{Camera, Options, Renderer};
use std::sync::Arc;

/// Pixels of the pictures.
pub const SIZE: [usize; 2] = [1280, 720];
/// Of every so many main steps one is drawn: at 50 Hz, 25 updates a second; and of these one in so many as a picture.
const EVERY: [u64; 2] = [2, 8];
/// Pictures are drawn no longer than this in all \[ms\].
const LONGEST: f64 = 6000.0;

/// The drawn scene along a session.
pub struct Views<'a> {
    prepared: &'a Prepared,
    scenery: Scenery<'a>,
    skinner: Skinner<'a>,
    places: Places,
    /// Skins for the next update, with the state that they were asked for in.
    made: Option<(Arc<Dressed>, BoneSample)>,
    camera: Camera,
    renderer: Renderer,
    growth: Vec<GrowthSample>,
    update: Times,
    skins: Pairs,
    render: Times,
    n_steps: u64,
}

impl<'a> Views<'a> {
    /// Of the bone before it breaks; `sawn`: its crack.
    ///
    /// # Errors
    /// A chisel that mechanics refuses.
    pub fn new(prepared: &'a Prepared, scenario: &'a Scenario, sawn: GrowthSample) -> Result<Self> {
        let aspect = SIZE[0] as f64 / SIZE[1] as f64;
        let mut skinner = Skinner::new(prepared);
        let dressed = skinner.sawn()?;
        Ok(Self {
            prepared,
            scenery: Scenery::new(prepared, scenario, dressed)?,
            skinner,
            places: Places::new(&prepared.bone.cracked, &prepared.patient.surface),
            made: None,
            camera: View::Close.camera(prepared, aspect),
            renderer: Renderer::fastest(),
            growth: vec![sawn],
            update: Times::default(),
            skins: Pairs::new("after a growth, beside the frames, all skins made anew"),
            render: Times::default(),
            n_steps: 0,
        })
    }

    /// The crack has grown.
    pub fn grew(&mut self, growth: GrowthSample) {
        self.growth.push(growth);
    }

    /// Where pictures are drawn, in half a sentence.
    pub fn place(&self) -> String {
        self.renderer.place()
    }

    /// The last crack.
    pub fn crack(&self) -> Option<&GrowthSample> {
        self.growth.last()
    }

    /// After a main step; `bone` is asked for only if it is this one's turn.
    ///
    /// # Errors
    /// A state that does not fit the bone.
    pub fn stepped(
        &mut self,
        bone: impl FnOnce() -> Option<BoneSample>,
        hands: [&HandSample; 2],
    ) -> Result<()> {
        self.n_steps += 1;
        if !self.n_steps.is_multiple_of(EVERY[0]) {
            return Ok(());
        }
        let bone = bone();
        let now = Instant {
            time: 0.0,
            bone: bone.as_ref(),
            hands,
            apart: 0.0,
            shows_tools: true,
            shows_loads: false,
            shows_head: false,
        };
        let made = self.made.take();
        let (moment, ms) = in_ms(|| {
            if let Some((dressed, state)) = made {
                self.scenery.dress(dressed, Some(&state))?;
            }
            self.scenery.moment(&now)
        });
        let moment = moment?;
        self.update.push(ms);
        if let Some(state) = bone.filter(|b| !self.scenery.suits(Some(b))) {
            self.made = Some((self.skins_of(&state)?, state));
        }
        if self.n_steps.is_multiple_of(EVERY[0] * EVERY[1]) && self.render.sum() < LONGEST {
            let scene = moment.scene();
            let options = Options {
                width: SIZE[0],
                height: SIZE[1],
                samples: 1,
                is_transparent: false,
            };
            let (image, ms) = in_ms(|| self.renderer.image(&scene, &self.camera, &options));
            std::hint::black_box(image);
            self.render.push(ms);
        }
        Ok(())
    }

    /// What the eye of the window has a thread beside it do, against skins made anew.
    fn skins_of(&mut self, bone: &BoneSample) -> Result<Arc<Dressed>> {
        let generation = usize::try_from(bone.generation)?;
        let (dressed, ours) = in_ms(|| self.skinner.make(generation, &self.growth));
        let dressed = dressed?;
        if self.skins.is_open() {
            let (anew, ms) = in_ms(|| Skins::of(&dressed.body, self.prepared, &self.places));
            ensure!(
                anew.bone == dressed.skins.bone,
                "a surface that followed the crack is not the one made anew"
            );
            self.skins.push(ours, ms, ms);
        }
        Ok(dressed)
    }

    /// The rows.
    pub fn rows(self) -> [Row; 2] {
        [
            Row::new(Part::VisualUpdate, self.update).against(self.skins),
            Row::new(Part::CsgRender, self.render),
        ]
    }
}
