//! One way to a frame, wherever it is drawn.
use crate::frame::{Frame, Image, Options, render};
#[cfg(feature = "gpu")]
use crate::gpu::{Fault, Gpu};
use crate::scene::{Camera, Scene};

/// Draws frames: on a graphics device if it has one, and whatever does not fit or fails there on the processor.
#[derive(Default)]
pub struct Renderer {
    #[cfg(feature = "gpu")]
    gpu: Option<Box<Gpu>>,
    why: Option<String>,
}

impl Renderer {
    /// On a graphics device if there is one, else on the processor. A driver that is itself a program on the processor does not
    /// count: over opaque and transparent frames it was measured no faster than this crate's own.
    pub fn fastest() -> Self {
        let mut made = Self::default();
        made.why = made.find(true).err();
        made
    }

    /// On the processor.
    pub fn processor() -> Self {
        Self::default()
    }

    /// On a graphics device, or what passes for one.
    ///
    /// # Errors
    /// Why there is none.
    pub fn device() -> Result<Self, String> {
        let mut made = Self::default();
        made.find(false)?;
        Ok(made)
    }

    #[cfg(feature = "gpu")]
    fn find(&mut self, is_hardware: bool) -> Result<(), String> {
        let gpu = Gpu::open(is_hardware).map_err(|f| f.to_string())?;
        self.gpu = Some(Box::new(gpu));
        Ok(())
    }

    #[cfg(not(feature = "gpu"))]
    fn find(&mut self, _: bool) -> Result<(), String> {
        Err("this build has no pictures from graphics devices".into())
    }

    /// Where frames are drawn, in half a sentence.
    pub fn place(&self) -> String {
        #[cfg(feature = "gpu")]
        if let Some(gpu) = &self.gpu {
            return gpu.name().to_owned();
        }
        match &self.why {
            Some(why) => format!("the processor ({why})"),
            None => "the processor".into(),
        }
    }

    /// A frame, as [`render`] makes it.
    pub fn frame(&mut self, scene: &Scene, camera: &Camera, options: &Options) -> Frame {
        #[cfg(feature = "gpu")]
        if let Some(frame) = self.on_device(|gpu| gpu.frame(scene, camera, options)) {
            return frame;
        }
        render(scene, camera, options)
    }

    /// The picture alone.
    pub fn image(&mut self, scene: &Scene, camera: &Camera, options: &Options) -> Image {
        #[cfg(feature = "gpu")]
        if let Some(image) = self.on_device(|gpu| gpu.image(scene, camera, options)) {
            return image;
        }
        render(scene, camera, options).image
    }

    /// `None` where the processor has to draw. A device that has failed is not asked again; what is too large for it is no
    /// failure.
    #[cfg(feature = "gpu")]
    fn on_device<T>(&mut self, draw: impl FnOnce(&mut Gpu) -> Result<T, Fault>) -> Option<T> {
        match draw(self.gpu.as_mut()?) {
            Ok(drawn) => Some(drawn),
            Err(Fault::TooLarge) => None,
            Err(fault) => {
                self.gpu = None;
                self.why = Some(fault.to_string());
                None
            }
        }
    }
}
