use crate::arguments::Demo;
use crate::output::Output;
pub fn run(_: &Demo, _: Output) -> wimu_host::Result<()> {
    Ok(())
}
