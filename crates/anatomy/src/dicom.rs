//! DICOM files as trees of elements, as far as segmentations need them: uncompressed, little endian (PS3.5, sections 7 and A.1, A.2;
//! PS3.10, section 7).
//!
//! Own, because `dicom-object` 0.10.1 (tried) takes the memory that a length announces (326 bytes: 4.2 GB), recurses as deep as
//! sequences are nested (1 MB: the stack overflows), and brings in tables under CC0, which `deny.toml` does not allow.
use rustc_hash::FxHashMap;

/// Group and element.
pub(crate) type Tag = (u16, u16);

/// Sequences within sequences, at most; segmentations have four.
const MAX_DEPTH: usize = 16;
/// Elements and items in all, at most; a thousand frames have twenty thousand.
const MAX_ELEMENTS: usize = 4_000_000;

const ITEM: Tag = (0xfffe, 0xe000);
const ITEM_END: Tag = (0xfffe, 0xe00d);
const SEQUENCE_END: Tag = (0xfffe, 0xe0dd);
const TRANSFER_SYNTAX: Tag = (0x0002, 0x0010);
const UNDEFINED: u32 = u32::MAX;

/// What an element holds: bytes of the file, or items.
#[derive(Debug)]
pub(crate) enum Value<'a> {
    Bytes(&'a [u8]),
    Items(Vec<Item<'a>>),
}

/// Elements by tag.
#[derive(Debug, Default)]
pub(crate) struct Item<'a>(FxHashMap<Tag, Value<'a>>);

type Parsed<T> = Result<T, String>;

/// A whole file's elements. `sequences` are those tags that hold items: a file in implicit form does not say so.
///
/// # Errors
/// What is wrong and where, in words.
pub(crate) fn parse<'a>(bytes: &'a [u8], sequences: &[Tag]) -> Parsed<Item<'a>> {
    const START: usize = 132;
    if bytes.get(START - 4..START) != Some(b"DICM") {
        return Err("it does not have \"DICM\" at byte 128".to_owned());
    }
    let mut reader = Reader {
        bytes,
        at: START,
        is_explicit: true,
        n_elements: 0,
        sequences,
    };
    let mut all = Item::default();
    while reader.peek().is_some_and(|(group, _)| group == 2) {
        reader.element(&mut all, 0)?;
    }
    let syntax = all.text(TRANSFER_SYNTAX)?;
    reader.is_explicit = match syntax.as_str() {
        "1.2.840.10008.1.2" => false,
        "1.2.840.10008.1.2.1" => true,
        other => {
            return Err(format!(
                "its transfer syntax {other:.64} is compressed or big endian; save it uncompressed (dcmtk: dcmconv +te, dcmdrle or dcmdjpeg)"
            ));
        }
    };
    while reader.at < bytes.len() {
        reader.element(&mut all, 0)?;
    }
    Ok(all)
}

impl<'a> Item<'a> {
    /// What it holds, as it stands in the file.
    pub(crate) fn bytes(&self, tag: Tag) -> Parsed<&'a [u8]> {
        match self.0.get(&tag) {
            Some(Value::Bytes(bytes)) => Ok(bytes),
            _ => Err(format!("element {} is missing", show(tag))),
        }
    }

    pub(crate) fn has(&self, tag: Tag) -> bool {
        self.0.contains_key(&tag)
    }

    pub(crate) fn text(&self, tag: Tag) -> Parsed<String> {
        let text = String::from_utf8_lossy(self.bytes(tag)?);
        Ok(text.trim_matches([' ', '\0']).to_owned())
    }

    /// An unsigned short.
    pub(crate) fn short(&self, tag: Tag) -> Parsed<u16> {
        match self.bytes(tag)? {
            [a, b] => Ok(u16::from_le_bytes([*a, *b])),
            other => Err(format!(
                "element {} has {} bytes in place of 2",
                show(tag),
                other.len()
            )),
        }
    }

    /// Numbers in letters (DS, IS).
    pub(crate) fn numbers<const N: usize>(&self, tag: Tag) -> Parsed<[f64; N]> {
        let text = self.text(tag)?;
        let wrong = || format!("element {} is \"{text:.60}\", not {N} numbers", show(tag));
        let parts = text.split('\\').map(|part| part.trim().parse().ok());
        let numbers: Option<Vec<f64>> = parts.collect();
        let numbers = numbers.filter(|n| n.iter().all(|x| x.is_finite()));
        numbers.and_then(|n| n.try_into().ok()).ok_or_else(wrong)
    }

    /// A sequence's items; none if it is missing.
    pub(crate) fn items(&self, tag: Tag) -> &[Item<'a>] {
        match self.0.get(&tag) {
            Some(Value::Items(items)) => items,
            _ => &[],
        }
    }
}

fn show((group, element): Tag) -> String {
    format!("({group:04X},{element:04X})")
}

struct Reader<'a, 's> {
    bytes: &'a [u8],
    at: usize,
    is_explicit: bool,
    n_elements: usize,
    sequences: &'s [Tag],
}

impl<'a> Reader<'a, '_> {
    fn take(&mut self, n: usize) -> Parsed<&'a [u8]> {
        let end = self.at.checked_add(n);
        let taken = end.and_then(|end| self.bytes.get(self.at..end));
        let taken = taken.ok_or_else(|| {
            let (at, left) = (self.at, self.bytes.len() - self.at);
            format!("{n} bytes are announced at byte {at}, where only {left} are left; the file is truncated")
        })?;
        self.at += n;
        Ok(taken)
    }

    fn short(&mut self) -> Parsed<u16> {
        let b = self.take(2)?;
        Ok(u16::from_le_bytes([b[0], b[1]]))
    }

    fn long(&mut self) -> Parsed<u32> {
        let b = self.take(4)?;
        Ok(u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
    }

    fn tag(&mut self) -> Parsed<Tag> {
        Ok((self.short()?, self.short()?))
    }

    fn peek(&self) -> Option<Tag> {
        let b = self.bytes.get(self.at..self.at + 4)?;
        let short = |k: usize| u16::from_le_bytes([b[k], b[k + 1]]);
        Some((short(0), short(2)))
    }

    fn count(&mut self) -> Parsed<()> {
        self.n_elements += 1;
        match self.n_elements > MAX_ELEMENTS {
            true => Err(format!("it has more than {MAX_ELEMENTS} elements")),
            false => Ok(()),
        }
    }

    /// Reads an element into `to`.
    fn element(&mut self, to: &mut Item<'a>, depth: usize) -> Parsed<()> {
        self.count()?;
        let begin = self.at;
        let tag = self.tag()?;
        let (mut is_sequence, mut is_unknown) = (self.sequences.contains(&tag), false);
        let length = if self.is_explicit {
            let kind = self.take(2)?;
            (is_sequence, is_unknown) = (kind == b"SQ", kind == b"UN");
            match kind {
                b"OB" | b"OD" | b"OF" | b"OL" | b"OV" | b"OW" | b"SQ" | b"SV" | b"UC" | b"UN"
                | b"UR" | b"UT" | b"UV" => {
                    self.take(2)?;
                    self.long()?
                }
                _ => u32::from(self.short()?),
            }
        } else {
            self.long()?
        };
        let value = if is_sequence || length == UNDEFINED {
            // What an unknown element of undefined length holds is in implicit form (PS3.5, 6.2.2).
            let was_explicit = self.is_explicit;
            self.is_explicit &= !is_unknown;
            let items = self.sequence(length, depth + 1);
            self.is_explicit = was_explicit;
            Value::Items(items.map_err(|e| at_depth(&e, tag, depth))?)
        } else {
            Value::Bytes(self.take(length as usize)?)
        };
        if to.0.insert(tag, value).is_some() {
            return Err(format!(
                "element {} is there twice, at byte {begin}",
                show(tag)
            ));
        }
        Ok(())
    }

    fn sequence(&mut self, length: u32, depth: usize) -> Parsed<Vec<Item<'a>>> {
        if depth > MAX_DEPTH {
            return Err(format!("sequences are nested more than {MAX_DEPTH} deep"));
        }
        let end = self.end(length)?;
        let mut items = Vec::new();
        while self.at < end {
            match (self.tag()?, self.long()?) {
                (ITEM, length) => items.push(self.item(length, depth)?),
                (SEQUENCE_END, 0) if length == UNDEFINED => return Ok(items),
                (tag, _) => {
                    return Err(format!("{} is where an item should begin", show(tag)));
                }
            }
        }
        self.ended(length, end)?;
        Ok(items)
    }

    fn item(&mut self, length: u32, depth: usize) -> Parsed<Item<'a>> {
        self.count()?;
        let end = self.end(length)?;
        let mut item = Item::default();
        while self.at < end {
            if length == UNDEFINED && self.peek() == Some(ITEM_END) {
                self.take(8)?;
                return Ok(item);
            }
            self.element(&mut item, depth)?;
        }
        self.ended(length, end)?;
        Ok(item)
    }

    /// Where a sequence or an item of this length ends at the latest.
    fn end(&self, length: u32) -> Parsed<usize> {
        if length == UNDEFINED {
            return Ok(self.bytes.len());
        }
        let end = self.at.checked_add(length as usize);
        end.filter(|end| *end <= self.bytes.len())
            .ok_or_else(|| "it is longer than the file; the file is truncated".to_owned())
    }

    fn ended(&self, length: u32, end: usize) -> Parsed<()> {
        match length == UNDEFINED || self.at != end {
            true => Err(format!("it does not end where it should, at byte {end}")),
            false => Ok(()),
        }
    }
}

/// Names the outermost sequence only.
fn at_depth(error: &str, tag: Tag, depth: usize) -> String {
    match depth {
        0 => format!("sequence {}: {error}", show(tag)),
        _ => error.to_owned(),
    }
}
