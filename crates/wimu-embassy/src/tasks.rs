//! The node's tasks.

/// Defines the tasks of a node with the board's types, because a task of embassy cannot be generic.
///
/// | argument | type |
/// |---|---|
/// | `sensor` | the [`InertialSensor`](wimu_node::InertialSensor) |
/// | `timer` | the [`Timer`](wimu_node::Timer) |
/// | `store` | the [`Store`](wimu_node::Store) |
/// | `cable` | the receiving and the sending half of the cable |
/// | `wireless` | those of the wireless link; `(NoLink, NoLink)` without one |
///
/// Expands to
/// - `Shared`, `Board` and `Node`, the types of the node,
/// - `place(board, &'static Shared) -> &'static mut Node`, which builds the node in a `static`,
/// - `spawn(node, above: SendSpawner, others: Spawner)`, which spawns the tasks, the sampler with `above`.
///
/// Each function may be called once; a second call panics. The board depends on `static_cell`.
#[macro_export]
macro_rules! tasks {
    (
        sensor: $sensor:ty,
        timer: $timer:ty,
        store: $store:ty,
        cable: ($reader:ty, $writer:ty),
        wireless: ($wireless_reader:ty, $wireless_writer:ty),
    ) => {
        use $crate::wimu_node as node;

        /// Memory of the node's tasks.
        pub type Shared = node::Shared<$crate::Mutex, <$sensor as node::InertialSensor>::Sample>;
        /// What the board provides.
        pub type Board = node::Board<
            $sensor,
            $timer,
            $store,
            $reader,
            $writer,
            $wireless_reader,
            $wireless_writer,
        >;
        /// The board's node.
        pub type Node = node::Node<
            'static,
            $sensor,
            $timer,
            $store,
            $reader,
            $writer,
            $wireless_reader,
            $wireless_writer,
            $crate::Mutex,
        >;

        /// Builds the node of a board in a `static`.
        pub fn place(board: Board, shared: &'static Shared) -> &'static mut Node {
            static NODE: ::static_cell::StaticCell<Node> = ::static_cell::StaticCell::new();
            NODE.init_with(|| board.split(shared))
        }

        $crate::node_tasks! {
            sample: node::Sampler<'static, $sensor, $timer, $crate::Mutex>,
            control: node::Control<'static, $sensor, $timer, $store, $crate::Mutex>,
            listen: node::LinkReader<'static, $reader, $timer, $crate::Mutex>,
            talk: node::LinkWriter<'static, $writer, $crate::Mutex>,
            listen_wireless: node::LinkReader<'static, $wireless_reader, $timer, $crate::Mutex>,
            talk_wireless: node::LinkWriter<'static, $wireless_writer, $crate::Mutex>,
        }

        /// Spawns the node's tasks, the sampler with `above`.
        pub fn spawn(
            node: &'static mut Node,
            above: $crate::embassy_executor::SendSpawner,
            others: $crate::embassy_executor::Spawner,
        ) {
            // No task is spawned more often than its pool allows.
            above.spawn(sample(&mut node.sampler).unwrap());
            others.spawn(control(&mut node.control).unwrap());
            others.spawn(listen(&mut node.cable_reader).unwrap());
            others.spawn(talk(&mut node.cable_writer).unwrap());
            if $crate::wimu_node::LINKS > 1 {
                others.spawn(listen_wireless(&mut node.wireless_reader).unwrap());
                others.spawn(talk_wireless(&mut node.wireless_writer).unwrap());
            }
        }
    };
}

/// The part of [`tasks!`] that runs the parts of the node.
#[doc(hidden)]
#[macro_export]
macro_rules! node_tasks {
    ($($name:ident: $part:ty,)*) => {$(
        #[$crate::embassy_executor::task(embassy_executor = $crate::embassy_executor)]
        async fn $name(part: &'static mut $part) -> ! {
            part.run().await
        }
    )*};
}
