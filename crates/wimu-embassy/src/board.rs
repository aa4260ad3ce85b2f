//! What every board has beside pins and clocks.

/// Defines a module `tasks` with the node's tasks ([`tasks!`](crate::tasks)), and with
/// - `supervise`, which feeds the watchdog by `$feed` while the tasks make progress within `$limits`,
/// - with a light, `show`, which shows the state, lit at the level `$lit`, and polls a button, pressed while low,
/// - `launch`, which builds the board's node and spawns all of them, the sampler with `above`.
///
/// `timer` is a unit struct. `record` is the [`StartRecord`](crate::StartRecord), `stack` a function that measures the stack.
#[macro_export]
macro_rules! board {
    (
        record: $record:expr,
        stack: $stack:expr,
        timer: $timer:ident,
        sensor: $sensor:ty,
        store: $store:ty,
        cable: ($reader:ty, $writer:ty),
        wireless: ($wireless_reader:ty, $wireless_writer:ty),
        watchdog: $watchdog:ty, $feed:expr, $limits:expr,
        $(light: ($led:ty, $button:ty), lit: $lit:expr,)?
    ) => {
        /// The tasks of the board.
        mod tasks {
            use super::*;

            $crate::tasks! {
                sensor: $sensor,
                timer: $timer,
                store: $store,
                cable: ($reader, $writer),
                wireless: ($wireless_reader, $wireless_writer),
            }

            /// Feeds the watchdog while the node works.
            #[$crate::embassy_executor::task(embassy_executor = $crate::embassy_executor)]
            async fn supervise(shared: &'static Shared, mut watchdog: $watchdog) -> ! {
                let feed: fn(&mut $watchdog) = $feed;
                let feed = || feed(&mut watchdog);
                $crate::supervise($limits, shared, &$record, $timer, $stack, feed).await
            }

            $(
                /// Shows the device's state with the LED and polls the button.
                #[$crate::embassy_executor::task(embassy_executor = $crate::embassy_executor)]
                async fn show(
                    shared: &'static Shared,
                    is_safe_mode: bool,
                    mut led: $led,
                    button: $button,
                ) -> ! {
                    let light = |on: bool| led.set_level((on == $lit).into());
                    $crate::attend(shared, is_safe_mode, $timer, light, || button.is_low()).await
                }
            )?

            /// Spawns the tasks of `board`, the sampler with `above`. Call it once.
            pub fn launch(
                board: Board,
                above: $crate::embassy_executor::SendSpawner,
                others: $crate::embassy_executor::Spawner,
                watchdog: $watchdog,
                $(light: ($led, $button),)?
            ) -> &'static Shared {
                static SHARED: Shared = Shared::new();
                $(
                    let (led, button): ($led, $button) = light;
                    others.spawn(show(&SHARED, board.hello.safe_mode, led, button).unwrap());
                )?
                spawn(place(board, &SHARED), above, others);
                others.spawn(supervise(&SHARED, watchdog).unwrap());
                &SHARED
            }
        }
    };
}
