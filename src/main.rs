fn main() {
    println!("periscope");
}
