//! Decodes a `.dgs` file and says what every frame holds: `decode_file FILE`.

use dgs_player::Player;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args().nth(1).ok_or("decode_file FILE")?;
    let (mut player, damage) = Player::open_file(path)?;
    println!("{}", if damage.is_none() { "whole".into() } else { damage.to_string() });
    for frame in 0..player.info().frames {
        let shown = player.frame(frame)?;
        println!("frame {frame}: {} Gaussians, degree {}", shown.gaussians.len(), shown.sh_degree.get());
    }
    Ok(())
}
