//! What of the teeth stands in the bone: segmentations give a tooth one label, root and crown.
use crate::labels::LabelVolume;
use rustc_hash::FxHashSet;

/// Voxels of teeth with bone around them: of three lines through the voxel, one along the volume's each axis, at least two meet the
/// bone within `REACH` mm on both sides. A crown has bone under it only.
pub fn in_sockets(volume: &LabelVolume, bone: u8, tooth: u8) -> FxHashSet<u32> {
    const REACH: f64 = 9.0;
    let edges = volume.affine.edges();
    let strides = [1, volume.size[0], volume.size[0] * volume.size[1]];
    let meets = |i: usize, axis: usize, is_up: bool| {
        let at = volume.index(i)[axis];
        let room = if is_up {
            volume.size[axis] - 1 - at
        } else {
            at
        };
        let reach = ((REACH / edges[axis]) as usize).min(room);
        (1..=reach).any(|k| {
            let j = if is_up {
                i + k * strides[axis]
            } else {
                i - k * strides[axis]
            };
            volume.voxels[j] == bone
        })
    };
    let is_rooted = |i: &usize| {
        let across = (0..3).filter(|a| meets(*i, *a, true) && meets(*i, *a, false));
        across.count() >= 2
    };
    (0..volume.voxels.len())
        .filter(|i| volume.voxels[*i] == tooth)
        .filter(is_rooted)
        .map(|i| i as u32)
        .collect()
}
