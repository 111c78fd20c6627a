//! The message trait, and the macro that keeps a type, its schema text and its hash in one place.

use bytemuck::Pod;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Signals of the vehicle to which the elements of a message's array belong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Each {
    /// Every state of the vehicle, in its order.
    State,
    /// Every input of the vehicle, in its order.
    Input,
    /// Every output of the vehicle, in its order.
    Output,
}

/// One field of a message, as laid out in memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Field {
    /// Field name.
    pub name: &'static str,
    /// Element type: `f64`, `u64`, `u32`, `u8` or `Head`.
    pub kind: &'static str,
    /// Number of elements; 1 for a scalar.
    pub count: usize,
    /// Offset from the start of the message, bytes.
    pub offset: usize,
    /// Signals to which the elements belong, if any.
    pub each: Option<Each>,
}

/// A fixed-size message that can travel over every transport.
pub trait Message:
    Pod + Serialize + DeserializeOwned + PartialEq + std::fmt::Debug + Send + Sync + 'static
{
    /// Topic under the bench's name, for example `imu`.
    const TOPIC: &'static str;
    /// Type name, for example `whirlstand/msg/Imu`.
    const TYPE_NAME: &'static str;
    /// Layout in ROS 2 message syntax, including nested types.
    const SCHEMA: &'static str;
    /// Fields in memory order, without gaps.
    const FIELDS: &'static [Field];
    /// FNV-1a of [`crate::VERSION`], [`Self::TYPE_NAME`] and [`Self::SCHEMA`].
    const SCHEMA_HASH: u64 = fnv1a(
        fnv1a(fnv1a(FNV_OFFSET, &crate::VERSION.to_le_bytes()), Self::TYPE_NAME.as_bytes()),
        Self::SCHEMA.as_bytes(),
    );

    /// The message with every byte zero.
    fn zeroed() -> Self {
        bytemuck::Zeroable::zeroed()
    }

    /// Sequence number, step and time of this message.
    fn head(&self) -> &crate::Head;

    /// Mutable access to [`Self::head`].
    fn head_mut(&mut self) -> &mut crate::Head;

    /// Name of the node from which the message claims to be; `None` for a type without a sender. A transport
    /// that knows the true sender refuses a message with another name.
    fn speaker(&self) -> Option<&str> {
        None
    }
}

const FNV_OFFSET: u64 = 0xcbf2_9ce4_8422_2325;

/// FNV-1a, 64 bits (Fowler, Noll, Vo; RFC 9923), continued from `hash`.
pub(crate) const fn fnv1a(mut hash: u64, bytes: &[u8]) -> u64 {
    let mut i = 0;
    while i < bytes.len() {
        hash = (hash ^ bytes[i] as u64).wrapping_mul(0x0000_0100_0000_01b3);
        i += 1;
    }
    hash
}

/// Defines a message: the struct, its traits, and the schema that logs and peers check.
macro_rules! message {
    (
        $(#[$meta:meta])*
        $name:ident on $topic:literal $(from $speaker:ident)? {
            $( $(#[$fmeta:meta])* $field:ident : $kind:ident $([$count:tt])? => $ros:literal ),+ $(,)?
        }
    ) => {
        $(#[$meta])*
        #[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize, bytemuck::Pod, bytemuck::Zeroable)]
        #[repr(C)]
        pub struct $name {
            /// Sequence number, step and time.
            pub head: $crate::Head,
            $( $(#[$fmeta])* pub $field: message!(@type $kind $([$count])?), )+
        }

        impl $crate::Message for $name {
            const TOPIC: &'static str = $topic;
            const TYPE_NAME: &'static str = concat!("whirlstand/msg/", stringify!($name));
            const SCHEMA: &'static str = concat!(
                "Head head\n",
                $( $ros, " ", stringify!($field), "\n", )+
                "================================================================================\n",
                "MSG: whirlstand/Head\nuint64 seq\nuint64 step\nuint64 stamp_ns\n",
            );
            const FIELDS: &'static [$crate::Field] = &[
                $crate::Field { name: "head", kind: "Head", count: 1, offset: 0, each: None },
                $( $crate::Field {
                    name: stringify!($field),
                    kind: stringify!($kind),
                    count: message!(@count $([$count])?),
                    offset: std::mem::offset_of!($name, $field),
                    each: message!(@each $([$count])?),
                }, )+
            ];

            fn head(&self) -> &$crate::Head {
                &self.head
            }

            fn head_mut(&mut self) -> &mut $crate::Head {
                &mut self.head
            }

            $(fn speaker(&self) -> Option<&str> {
                Some(self.$speaker())
            })?
        }
    };
    (@type $kind:ident) => { $kind };
    (@type $kind:ident [$count:tt]) => { [$kind; $count] };
    (@count) => { 1 };
    (@count [$count:tt]) => { $count };
    (@each [MAX_STATES]) => { Some($crate::Each::State) };
    (@each [MAX_INPUTS]) => { Some($crate::Each::Input) };
    (@each [MAX_OUTPUTS]) => { Some($crate::Each::Output) };
    (@each $([$count:tt])?) => { None };
}
pub(crate) use message;
