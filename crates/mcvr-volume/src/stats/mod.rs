//! What a volume holds, in numbers, and whether it seems to have been read in the wrong byte order.

mod byte_order;
mod summary;

pub use byte_order::byte_order_suspicion;
pub use summary::{HISTOGRAM_BINS, Summary};
