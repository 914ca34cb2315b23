//! Voxel types, and the buffer that holds them in their own type: owned or mapped from a file.

use std::ops::Deref;
use std::sync::Arc;

use memmap2::Mmap;
use serde::{Deserialize, Serialize};

/// A scalar type that a voxel can have.
pub trait Voxel: bytemuck::Pod + PartialOrd + Send + Sync + 'static {
    /// The run-time name of this type.
    const TYPE: VoxelType;

    /// The stored value as `f64`; exact for every supported type.
    fn to_f64(self) -> f64;

    /// Position of this value among all values of an 8- or 16-bit type (smallest value first), for
    /// look-up tables; `None` for wider types.
    fn ordinal(self) -> Option<usize>;

    /// The value that has an [ordinal](Voxel::ordinal); `None` for wider types, and where no value has it.
    fn of_ordinal(ordinal: usize) -> Option<Self>;

    /// The value with its bytes in opposite order.
    fn swap_bytes(self) -> Self;

    /// Wraps a buffer of this type.
    fn wrap(buffer: Buffer<Self>) -> Voxels;
}

macro_rules! voxel_types {
    ($($variant:ident $t:ty, $name:literal, $ordinal:expr, $of:expr, $swap:expr;)*) => {
        /// Run-time name of a voxel type.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
        #[serde(rename_all = "lowercase")]
        pub enum VoxelType { $(#[doc = $name] $variant,)* }

        impl VoxelType {
            /// Every supported type.
            pub const ALL: &'static [VoxelType] = &[$(VoxelType::$variant,)*];

            /// Bytes per voxel.
            pub fn bytes(self) -> usize { match self { $(VoxelType::$variant => size_of::<$t>(),)* } }

            /// Short name: `u8`, `i16`, `f32`, ...
            pub fn name(self) -> &'static str { match self { $(VoxelType::$variant => $name,)* } }
        }

        impl std::str::FromStr for VoxelType {
            type Err = String;
            fn from_str(s: &str) -> Result<Self, String> {
                match s {
                    $($name => Ok(VoxelType::$variant),)*
                    _ => Err(format!("unknown voxel type '{s}'; one of {}",
                        [$($name,)*].join(", "))),
                }
            }
        }

        /// Voxels of any supported type, kept in that type. Use [`with_voxels!`](crate::with_voxels) to
        /// run generic code over the contents.
        #[derive(Clone, Debug)]
        pub enum Voxels { $(#[doc = concat!("Voxels of type ", $name, ".")] $variant(Buffer<$t>),)* }

        impl Voxels {
            /// The type of the voxels.
            pub fn voxel_type(&self) -> VoxelType { match self { $(Voxels::$variant(_) => VoxelType::$variant,)* } }
        }

        $(impl Voxel for $t {
            const TYPE: VoxelType = VoxelType::$variant;
            #[inline(always)]
            fn to_f64(self) -> f64 { self as f64 }
            #[inline(always)]
            fn ordinal(self) -> Option<usize> { let f: fn($t) -> Option<usize> = $ordinal; f(self) }
            fn of_ordinal(ordinal: usize) -> Option<$t> { let f: fn(usize) -> Option<$t> = $of; f(ordinal) }
            #[inline(always)]
            fn swap_bytes(self) -> Self { let f: fn($t) -> $t = $swap; f(self) }
            fn wrap(buffer: Buffer<Self>) -> Voxels { Voxels::$variant(buffer) }
        })*

        /// Runs an expression with the voxel buffer bound to a typed [`Buffer`](crate::Buffer), once
        /// compiled per voxel type: `with_voxels!(volume.voxels(), v => v.len())`.
        #[macro_export]
        macro_rules! with_voxels {
            ($voxels:expr, $v:ident => $body:expr) => {
                match $voxels { $($crate::Voxels::$variant($v) => $body,)* }
            };
        }
    };
}

voxel_types! {
    U8 u8, "u8", |v| Some(v as usize), |i| u8::try_from(i).ok(), |v| v;
    I8 i8, "i8", |v| Some((v as i16 + 128) as usize), |i| i8::try_from(i as i64 - 128).ok(), |v| v;
    U16 u16, "u16", |v| Some(v as usize), |i| u16::try_from(i).ok(), u16::swap_bytes;
    I16 i16, "i16", |v| Some((v as i32 + 32768) as usize), |i| i16::try_from(i as i64 - 32768).ok(), i16::swap_bytes;
    U32 u32, "u32", |_| None, |_| None, u32::swap_bytes;
    I32 i32, "i32", |_| None, |_| None, i32::swap_bytes;
    F32 f32, "f32", |_| None, |_| None, |v| f32::from_bits(v.to_bits().swap_bytes());
    F64 f64, "f64", |_| None, |_| None, |v| f64::from_bits(v.to_bits().swap_bytes());
}

impl std::fmt::Display for VoxelType {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl VoxelType {
    /// Number of distinct values of an 8- or 16-bit type, `None` for wider ones.
    pub fn cardinality(self) -> Option<usize> {
        match self.bytes() {
            1 => Some(1 << 8),
            2 => Some(1 << 16),
            _ => None,
        }
    }
}

/// A read-only run of voxels: a vector, or part of a mapped file that is used in place.
#[derive(Clone, Debug)]
pub struct Buffer<T> {
    inner: Inner<T>,
}

#[derive(Clone, Debug)]
enum Inner<T> {
    Owned(Arc<Vec<T>>),
    Mapped { map: Arc<Mmap>, offset: usize, len: usize },
}

impl<T: Voxel> Buffer<T> {
    /// Takes part of a mapped file: `len` voxels from byte `offset`, in this machine's byte order.
    /// `None` when the range leaves the map or is not aligned for `T`.
    pub fn mapped(map: Arc<Mmap>, offset: usize, len: usize) -> Option<Self> {
        let end = len.checked_mul(size_of::<T>())?.checked_add(offset)?;
        let bytes = map.get(offset..end)?;
        bytemuck::try_cast_slice::<u8, T>(bytes).ok()?;
        Some(Self { inner: Inner::Mapped { map, offset, len } })
    }

    /// True when the voxels live in a mapped file rather than in this process's own memory.
    pub fn is_mapped(&self) -> bool {
        matches!(self.inner, Inner::Mapped { .. })
    }
}

impl<T> From<Vec<T>> for Buffer<T> {
    fn from(v: Vec<T>) -> Self {
        Self { inner: Inner::Owned(Arc::new(v)) }
    }
}

impl<T: Voxel> Deref for Buffer<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        match &self.inner {
            Inner::Owned(v) => v,
            Inner::Mapped { map, offset, len } => bytemuck::cast_slice(&map[*offset..*offset + *len * size_of::<T>()]),
        }
    }
}

impl Voxels {
    /// Number of voxels.
    pub fn len(&self) -> usize {
        with_voxels!(self, v => v.len())
    }

    /// True when there are no voxels.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The stored value at a linear index, before slope and intercept.
    ///
    /// # Panics
    /// When the index is out of range, as slices do.
    pub fn get_f64(&self, linear: usize) -> f64 {
        with_voxels!(self, v => v[linear].to_f64())
    }

    /// True when the voxels live in a mapped file.
    pub fn is_mapped(&self) -> bool {
        with_voxels!(self, v => v.is_mapped())
    }
}
