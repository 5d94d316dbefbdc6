//! From a moment to a picture: frame, captions, file.
use super::look::LOAD_LETTERS;
use super::stage::Moment;
use crate::scenario::Eyes;
use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use osteotome_render::{Camera, Canvas, Image, Options, Renderer, Stereo, compose};
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// How a picture is to look.
#[derive(Clone, Copy, Debug)]
pub struct Finish {
    /// Pixels across and down.
    pub size: [usize; 2],
    /// Whether one looks through the bone.
    pub is_transparent: bool,
    /// For two eyes.
    pub stereo: Option<StereoMode>,
}

/// How the pictures of both eyes, or of more views, share one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StereoMode {
    /// Columns, left eye left.
    SideBySide,
    /// Bands, left eye above.
    OverUnder,
    /// Rows in turn.
    Interlaced,
    /// Red and cyan glasses.
    Anaglyph,
}

/// Distance of the eyes over that of what they look at: the usual bound of comfort.
const EYES: f32 = 1.0 / 30.0;

impl Finish {
    /// Makes the picture.
    pub fn print(
        &self,
        renderer: &mut Renderer,
        moment: &Moment,
        camera: &Camera,
        title: &str,
    ) -> Image {
        let [width, height] = self.size;
        let options = Options {
            width,
            height,
            samples: 2,
            is_transparent: self.is_transparent,
        };
        let scene = moment.scene();
        let mut eye = |camera: &Camera| {
            let mut image = renderer.image(&scene, camera, &options);
            annotate(&mut image, camera, moment, title);
            image
        };
        let Some(stereo) = self.stereo else {
            return eye(camera);
        };
        let views: Vec<Image> = stereo
            .views(camera, moment.eyes())
            .iter()
            .map(eye)
            .collect();
        stereo.join(&views)
    }
}

impl StereoMode {
    /// The eyes of an observer at `camera`, from left to right; coloured glasses have two.
    pub fn views(self, camera: &Camera, wanted: Eyes) -> Vec<Camera> {
        let convergence = wanted.convergence.map_or(camera.distance, |mm| mm as f32);
        let separation = wanted.eye_separation.map(|mm| mm as f32);
        let separation = separation.unwrap_or(EYES * convergence);
        let converging = Camera {
            distance: convergence,
            ..*camera
        };
        let n = match self {
            Self::Anaglyph => 2,
            _ => wanted.views.unwrap_or(2),
        };
        let eye = |k: usize| Camera {
            // Where a scale bar is right.
            distance: camera.distance,
            ..converging.aside((k as f32 - 0.5 * (n - 1) as f32) * separation)
        };
        (0..n).map(eye).collect()
    }

    /// The pictures of all views in one.
    pub fn join(self, views: &[Image]) -> Image {
        let mode = match self {
            Self::SideBySide => Stereo::SideBySide,
            Self::OverUnder => Stereo::OverUnder,
            Self::Interlaced => Stereo::Interlaced,
            Self::Anaglyph => Stereo::Anaglyph,
        };
        compose(views, mode)
    }
}

const WHITE: [u8; 3] = [235, 238, 242];
const GREY: [u8; 3] = [150, 158, 168];

/// Caption, loads, scale bar and orientation marker.
fn annotate(image: &mut Image, camera: &Camera, moment: &Moment, title: &str) {
    let (w, h) = (image.width as f32, image.height as f32);
    let letter = (h / 42.0).clamp(8.0, 40.0);
    let margin = 1.6 * letter;
    let mut canvas = Canvas::new(image);
    let caption = format!("{:.2} s  {title}", moment.time);
    canvas.text([margin, margin], letter, WHITE, caption.trim_end());
    let broken = match moment.growth.severed {
        true => format!("SPLIT, {:.0} mm2 BROKEN", moment.growth.area),
        false => format!("{:.0} mm2 BROKEN", moment.growth.area),
    };
    canvas.text([margin, margin + 1.8 * letter], 0.8 * letter, GREY, &broken);
    for (i, name) in ["LEFT HAND", "RIGHT HAND"].into_iter().enumerate() {
        let [force, torque] = moment.loads[i];
        let text = format!("{name}  {force:.0} N  {torque:.0} N mm");
        let left = w - margin - Canvas::text_width(0.8 * letter, &text);
        let top = margin + 1.6 * letter * i as f32;
        canvas.text([left, top], 0.8 * letter, LOAD_LETTERS[i], &text);
    }
    scale_bar(
        &mut canvas,
        [margin, h - margin],
        letter,
        camera.half_heights_per_mm() * 0.5 * h,
    );
    orientation(
        &mut canvas,
        [w - 3.9 * letter - margin, h - 3.9 * letter - margin],
        letter,
        camera,
    );
}

/// A round length of about a tenth of the picture; true where the camera looks at.
pub(super) fn scale_bar(canvas: &mut Canvas, [x, y]: [f32; 2], letter: f32, pixels_per_mm: f32) {
    let wanted = 7.0 * letter / pixels_per_mm;
    let length = [1.0, 2.0, 5.0, 10.0, 20.0, 50.0]
        .into_iter()
        .rfind(|l| *l <= wanted)
        .unwrap_or(1.0);
    let end = x + length * pixels_per_mm;
    let stroke = 0.16 * letter;
    for (a, b) in [
        ([x, y], [end, y]),
        ([x, y - 0.4 * letter], [x, y]),
        ([end, y - 0.4 * letter], [end, y]),
    ] {
        canvas.rimmed_line(a, b, stroke, WHITE);
    }
    canvas.text(
        [x + 0.3 * letter, y - 1.9 * letter],
        letter,
        WHITE,
        &format!("{length:.0} mm"),
    );
}

/// The patient's axes: left, posterior and superior are +x, +y and +z. What points towards the eye is bright.
pub(super) fn orientation(canvas: &mut Canvas, centre: [f32; 2], letter: f32, camera: &Camera) {
    let names = [["L", "R"], ["P", "A"], ["S", "I"]];
    let mut ends = Vec::new();
    for (k, pair) in names.iter().enumerate() {
        for (name, sign) in pair.iter().zip([1.0, -1.0]) {
            let [right, up, forward] = camera.axes.map(|a| sign * a[k]);
            ends.push((forward, right, up, *name));
        }
    }
    // The farthest first.
    ends.sort_by(|a, b| b.0.total_cmp(&a.0));
    for (forward, right, up, name) in ends {
        let color = if forward < 0.25 {
            WHITE
        } else {
            [105, 113, 123]
        };
        let at = |r: f32| [centre[0] + r * letter * right, centre[1] - r * letter * up];
        canvas.rimmed_line(centre, at(2.6), 0.13 * letter, color);
        // A letter on an axis that points at the eye would cover the middle.
        if right.hypot(up) > 0.3 {
            let [x, y] = at(3.6);
            canvas.text([x - 0.33 * letter, y - 0.5 * letter], letter, color, name);
        }
    }
}

/// The bytes of a PNG file.
///
/// # Errors
/// None that a picture of this program's could cause.
pub(super) fn encode_png(image: &Image) -> Result<Vec<u8>> {
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, image.width as u32, image.height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
    let mut writer = encoder.write_header()?;
    let pixels = image.pixels.iter();
    let bytes: Vec<u8> = pixels.flat_map(|p| [p[0], p[1], p[2]]).collect();
    writer.write_image_data(&bytes)?;
    writer.finish()?;
    Ok(file)
}

/// Writes a PNG file; it appears whole or not at all.
///
/// # Errors
/// Whatever the file system says.
pub fn write_png(path: &Path, image: &Image) -> Result<()> {
    let shown = || path.display().to_string();
    let partial = with_suffix(path);
    let work = || -> Result<()> {
        std::fs::write(&partial, encode_png(image)?)?;
        std::fs::rename(&partial, path)?;
        Ok(())
    };
    let result = work().with_context(shown);
    if result.is_err() {
        // The name says what it is if even this fails.
        let _ = std::fs::remove_file(&partial);
    }
    result
}

/// A film in the making: frames go to ffmpeg, which writes `FILE.partial`, renamed at the end. Dropped before that, it goes away.
pub struct Video {
    ffmpeg: Child,
    partial: PathBuf,
    wanted: PathBuf,
    is_done: bool,
}

impl Video {
    /// Frames a second.
    pub const RATE: u32 = 25;

    /// Starts ffmpeg for frames of even `size`.
    ///
    /// # Errors
    /// If there is no ffmpeg.
    pub fn start(path: &Path, size: [usize; 2]) -> Result<Self> {
        let partial = with_suffix(path);
        let pixels = format!("{}x{}", size[0], size[1]);
        let rate = Self::RATE.to_string();
        let mut command = Command::new("ffmpeg");
        command.args([
            "-loglevel",
            "error",
            "-y",
            "-f",
            "rawvideo",
            "-pix_fmt",
            "rgba",
        ]);
        command.args([
            "-s", &pixels, "-r", &rate, "-i", "-", "-pix_fmt", "yuv420p", "-f", "mp4",
        ]);
        command.arg(&partial).stdin(Stdio::piped());
        match command.spawn() {
            Ok(ffmpeg) => Ok(Self {
                ffmpeg,
                partial,
                wanted: path.to_owned(),
                is_done: false,
            }),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => bail!(
                "--video {}: ffmpeg is not installed; install it, or make pictures with -o",
                path.display()
            ),
            Err(error) => Err(error).context("ffmpeg"),
        }
    }

    /// Adds a frame.
    ///
    /// # Errors
    /// If ffmpeg has ended.
    pub fn push(&mut self, image: &Image) -> Result<()> {
        let stdin = self
            .ffmpeg
            .stdin
            .as_mut()
            .context("ffmpeg takes no frames")?;
        let bytes: Vec<u8> = image.pixels.iter().flatten().copied().collect();
        stdin
            .write_all(&bytes)
            .context("ffmpeg ended early; its message is above")
    }

    /// Waits for the file.
    ///
    /// # Errors
    /// If ffmpeg failed.
    pub fn finish(mut self) -> Result<()> {
        drop(self.ffmpeg.stdin.take());
        if !self.ffmpeg.wait()?.success() {
            bail!("ffmpeg failed; its message is above");
        }
        std::fs::rename(&self.partial, &self.wanted)
            .with_context(|| self.wanted.display().to_string())?;
        self.is_done = true;
        Ok(())
    }
}

impl Drop for Video {
    fn drop(&mut self) {
        if !self.is_done {
            drop(self.ffmpeg.stdin.take());
            // Nothing half written stays behind; if even this fails, the name says what it is.
            let _ = self.ffmpeg.wait();
            let _ = std::fs::remove_file(&self.partial);
        }
    }
}

fn with_suffix(path: &Path) -> PathBuf {
    let mut partial = path.as_os_str().to_owned();
    partial.push(".partial");
    partial.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eyes_are_as_far_apart_and_converge_where_the_scenario_says() {
        let camera = Camera::look_at([0.0; 3], [0.0, 200.0, 0.0], [0.0, 0.0, 1.0], 40.0);
        let near = Eyes {
            eye_separation: Some(10.0),
            convergence: Some(120.0),
            views: None,
        };
        for (wanted, at, separation) in
            [(Eyes::default(), 200.0, 200.0 / 30.0), (near, 120.0, 10.0)]
        {
            let eyes = StereoMode::SideBySide.views(&camera, wanted);
            let [left, right] = eyes.try_into().unwrap();
            assert!((right.eye[0] - left.eye[0] - separation).abs() < 1e-3);
            // Both middles of the picture meet there.
            let shift = 0.5 * separation / (at * camera.tangent);
            assert!((right.shift - shift).abs() < 1e-6 && (left.shift + shift).abs() < 1e-6);
            assert_eq!(left.distance, camera.distance);
        }
        let five = Eyes {
            views: Some(5),
            ..near
        };
        let places = |mode: StereoMode| -> Vec<f32> {
            mode.views(&camera, five).iter().map(|c| c.eye[0]).collect()
        };
        assert_eq!(
            places(StereoMode::Interlaced),
            [-20.0, -10.0, 0.0, 10.0, 20.0]
        );
        assert_eq!(places(StereoMode::Anaglyph), [-5.0, 5.0]);
    }
}
