//! Numbers packed for a page: little-endian, Base64 (RFC 4648).
const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

/// Base64 of bytes.
pub fn base64(bytes: &[u8]) -> String {
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let word =
            chunk.iter().fold(0u32, |w, b| w << 8 | u32::from(*b)) << (8 * (3 - chunk.len()));
        for k in 0..4 {
            let letter = LETTERS[(word >> (18 - 6 * k) & 63) as usize];
            text.push(if k <= chunk.len() {
                letter as char
            } else {
                '='
            });
        }
    }
    text
}

/// 32-bit floats.
pub fn floats(values: impl IntoIterator<Item = f64>) -> String {
    let bytes = values.into_iter().flat_map(|v| (v as f32).to_le_bytes());
    base64(&bytes.collect::<Vec<u8>>())
}

/// 32-bit whole numbers.
pub fn indices(values: impl IntoIterator<Item = u32>) -> String {
    let bytes = values.into_iter().flat_map(u32::to_le_bytes);
    base64(&bytes.collect::<Vec<u8>>())
}

/// 16-bit numbers in units of `unit`, clamped.
pub fn shorts(values: impl IntoIterator<Item = f64>, unit: f64) -> String {
    let short = |v: f64| (v / unit).round().clamp(-32767.0, 32767.0) as i16;
    let bytes = values.into_iter().flat_map(|v| short(v).to_le_bytes());
    base64(&bytes.collect::<Vec<u8>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_examples_of_rfc_4648() {
        let pairs = [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foob", "Zm9vYg=="),
            ("fooba", "Zm9vYmE="),
            ("foobar", "Zm9vYmFy"),
        ];
        for (bytes, text) in pairs {
            assert_eq!(base64(bytes.as_bytes()), text);
        }
        assert_eq!(shorts([0.25, -1e9], 0.25), base64(&[1, 0, 1, 128]));
    }
}
