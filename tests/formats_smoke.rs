use embree_trace::format::bvh::{self, Bvh, Contents};
use embree_trace::format::rays::*;
use embree_trace::geometry::{Triangle, Vec3};
use embree_trace::tree::{Node, Tree};

#[test]
fn smoke() {
    let record = Record { t: 1.0, flags: 5, ..bytemuck::Zeroable::zeroed() };
    let records: Vec<Record> = (0..1000).map(|i| Record { tnear: i as f32, ..record }).collect();
    let rejects: Vec<Reject> = (0..1000).map(|record| Reject { record, triangle: 7 }).collect();
    for codec in [Codec::Raw, Codec::Compressed] {
        let mut w = RaysWriter::new(Vec::new(), &Header::default()).unwrap();
        for sequence in [0, 1000] {
            w.write_chunk(&ChunkInfo { sequence, ..Default::default() }, &records, &rejects, codec).unwrap();
        }
        let (bytes, totals) = w.finish().unwrap();
        assert_eq!(bytes.len() as u64, totals.bytes);
        let rays = Rays::parse(&bytes).unwrap();
        assert_eq!(rays.query_count(), 2000);
        assert_eq!(rays.chunk(1).unwrap().records, records);
        assert_eq!(rays.chunk(1).unwrap().rejects, rejects);
        let cut = Rays::parse(&bytes[..bytes.len() - 200]).unwrap();
        assert_eq!(cut.recovery.unwrap().queries, 1000);
    }
    let t = Triangle([Vec3::ZERO, Vec3::X, Vec3::Y]);
    let tree = Tree { nodes: vec![Node::leaf(t.bounds(), 0, 1)], primitives: vec![0] };
    let contents = Contents {
        tree: tree.view(),
        triangles: &[t],
        geometries: &[],
        order: None,
        meta: Some("{}"),
        flags: 0,
        producer: "x",
    };
    let mut bytes = Vec::new();
    bvh::write(&mut bytes, &contents).unwrap();
    Bvh::parse(&bytes).unwrap().verify().unwrap();
}
