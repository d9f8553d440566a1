//! Little-endian fields in a byte buffer, without panics: used by the message layouts and by the
//! CANopen mappings. A writer or reader past the end reports it by its type, never by a panic.

/// Writes fields one after the other; what does not fit is dropped and `finish` then says so.
#[derive(Debug)]
pub struct FieldWriter<'a> {
    bytes: &'a mut [u8],
    used: usize,
    overflow: bool,
}

impl<'a> FieldWriter<'a> {
    /// Starts at the first byte of `bytes`.
    pub fn new(bytes: &'a mut [u8]) -> Self {
        Self { bytes, used: 0, overflow: false }
    }

    /// Appends raw bytes.
    pub fn bytes(&mut self, source: &[u8]) -> &mut Self {
        match self.bytes.get_mut(self.used..self.used + source.len()) {
            Some(target) => {
                target.copy_from_slice(source);
                self.used += source.len();
            }
            None => self.overflow = true,
        }
        self
    }

    /// Appends the low `width` (at most 8) bytes of `value`, least significant first.
    pub fn uint(&mut self, value: u64, width: usize) -> &mut Self {
        let bytes = value.to_le_bytes();
        self.bytes(&bytes[..width.min(8)])
    }

    /// Appends an IEEE 754 double.
    pub fn float(&mut self, value: f64) -> &mut Self {
        self.uint(value.to_bits(), 8)
    }

    /// Number of bytes written, or `None` when something did not fit.
    pub fn finish(&self) -> Option<usize> {
        (!self.overflow).then_some(self.used)
    }
}

/// Reads fields one after the other; past the end every field is `None`.
#[derive(Clone, Copy, Debug)]
pub struct FieldReader<'a> {
    bytes: &'a [u8],
}

impl<'a> FieldReader<'a> {
    /// Starts at the first byte of `bytes`.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { bytes }
    }

    /// Takes `count` raw bytes.
    pub fn bytes(&mut self, count: usize) -> Option<&'a [u8]> {
        let (head, tail) = self.bytes.split_at_checked(count)?;
        self.bytes = tail;
        Some(head)
    }

    /// Takes an unsigned integer of `width` (at most 8) bytes.
    pub fn uint(&mut self, width: usize) -> Option<u64> {
        let source = self.bytes(width)?;
        let mut bytes = [0_u8; 8];
        bytes.get_mut(..width)?.copy_from_slice(source);
        Some(u64::from_le_bytes(bytes))
    }

    /// Takes a two's complement integer of `width` (1 to 4) bytes.
    pub fn int(&mut self, width: usize) -> Option<i32> {
        let value = self.uint(width)?;
        let shift = 64_usize.checked_sub(8 * width)?;
        i32::try_from(((value << shift) as i64) >> shift).ok()
    }

    /// Takes an IEEE 754 double.
    pub fn float(&mut self) -> Option<f64> {
        self.uint(8).map(f64::from_bits)
    }

    /// Takes a 16-byte text, zero-padded.
    pub fn text(&mut self) -> Option<[u8; 16]> {
        self.bytes(16)?.try_into().ok()
    }

    /// Whether nothing is left.
    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signed_fields_keep_their_sign_at_every_width() {
        for (bytes, width, expected) in [
            (&[0xff_u8][..], 1, -1),
            (&[0x00, 0x80][..], 2, -32_768),
            (&[0x00, 0x00, 0x80][..], 3, -8_388_608),
            (&[0xff, 0xff, 0x7f][..], 3, 8_388_607),
            (&[0x00, 0x00, 0x00, 0x80][..], 4, i32::MIN),
        ] {
            assert_eq!(FieldReader::new(bytes).int(width), Some(expected));
        }
        assert_eq!(FieldReader::new(&[1, 2]).uint(3), None);
    }

    #[test]
    fn a_writer_reports_what_did_not_fit() {
        let mut room = [0_u8; 3];
        assert_eq!(FieldWriter::new(&mut room).uint(7, 2).uint(7, 2).finish(), None);
        assert_eq!(FieldWriter::new(&mut room).uint(0x0001_0203, 3).finish(), Some(3));
        assert_eq!(room, [3, 2, 1]);
    }
}
