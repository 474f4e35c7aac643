use meissner::pattern::Drive; use meissner::simulate::{Scene, run}; use meissner::skin::*;
fn weights(r: &[Position]) -> Vec<[f64;24]> { r.iter().map(|p| std::array::from_fn(|m| { let q = meissner::array::position_mm(m as u8); let d2=(p.x_mm-q[0]).powi(2)+(p.y_mm-q[1]).powi(2); let w=(-d2/2.0/1.21f64).exp(); if w<1e-10 {0.0} else {w} })).collect() }
fn main() {
    let list: Vec<serde_json::Value> = serde_json::from_str(include_str!("../tests/data/spikes.json")).unwrap();
    let mut worst: f64 = 0.0; let mut n=0;
    for s in &list {
        let m=&s["receptor"];
        let rect = match m["rectify"].as_str().unwrap() {"half"=>Rectify::Half,"full"=>Rectify::Full,_=>Rectify::Signed};
        let scene = Scene { duration_s: s["duration_s"].as_f64().unwrap(), seed:0,
          drives: s["drives"].as_array().unwrap().iter().map(|d| Drive{motor:d["motor"].as_u64().unwrap() as u8, frequency_hz:d["frequency_hz"].as_f64().unwrap(), amplitude_um:d["amplitude_um"].as_f64().unwrap(), phase:d["phase"].as_f64().unwrap(), start_s:None, stop_s:None}).collect(),
          receptors: s["receptors"].as_array().unwrap().iter().map(|r| Position{x_mm:r["x_mm"].as_f64().unwrap(), y_mm:r["y_mm"].as_f64().unwrap()}).collect(),
          model: RaModel{rectify:rect, alpha_per_um:m["alpha_per_um"].as_f64().unwrap(), tau_s:0.044, refractory_s:0.001, hyperexcitability_s:0.044, hyperexcitability_depth:m["hyperexcitability_depth"].as_f64().unwrap(), sigma_mm:1.1, noise_sd:0.0}};
        let w = weights(&scene.receptors); let order: Vec<u32> = (0..w.len() as u32).collect();
        let got = run(&scene,&order,&w);
        for (g,e) in got.iter().zip(s["spikes_s"].as_array().unwrap()) { let e: Vec<f64>=e.as_array().unwrap().iter().map(|x|x.as_f64().unwrap()).collect();
            if g.len()!=e.len() { println!("count {} vs {}", g.len(), e.len()); }
            for (a,b) in g.iter().zip(&e) { worst=worst.max((a-b).abs()); n+=1; } }
    }
    println!("{n} spikes, worst {worst:e}");
    // bench
    let mut z=12345u64; let mut u=||{z=z.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407); (z>>11) as f64/(1u64<<53) as f64};
    let mut rec=vec![]; for (n,s) in [(238,1.0),(68,-1.0)] { let mut k=0; while k<n { let (x,y)=(u()*18.0-9.0,u()*12.0); if (x/9.0).powi(2)+(y/12.0).powi(2)<=1.0 {rec.push(Position{x_mm:x,y_mm:s*y});k+=1;} } }
    let scene = Scene{duration_s:1.0,seed:1,drives:(0..24).map(|m| Drive{motor:m,frequency_hz:60.0,amplitude_um:80.0,phase:u(),start_s:None,stop_s:None}).collect(),receptors:rec,
        model: RaModel{rectify:Rectify::Half,alpha_per_um:std::env::var("A").map_or(0.0492,|a|a.parse().unwrap()),tau_s:0.044,refractory_s:0.001,hyperexcitability_s:0.044,hyperexcitability_depth:0.3,sigma_mm:1.1,noise_sd:0.05}};
    let w=weights(&scene.receptors);
    let mut order: Vec<u32>=(0..w.len() as u32).filter(|&r| w[r as usize].iter().sum::<f64>()*0.0492*80.0>0.8).collect();
    println!("active {}", order.len());
    order.sort_by_key(|&r| { let p=scene.receptors[r as usize]; let (a,b)=(((p.x_mm+9.0)/18.0*16.0) as u32, ((p.y_mm+12.0)/24.0*16.0) as u32); let mut k=0; for i in 0..4 { k|=((a>>i)&1)<<(2*i)|((b>>i)&1)<<(2*i+1);} k });
    if std::env::var("US").is_err() { use meissner::simulate::*; let o2: Vec<u32>=(0..order.len() as u32).collect(); let w2: Vec<_>=order.iter().map(|&r| w[r as usize]).collect();
      let e=run(&scene,&o2,&w2);
      for us in [1,10,20,50,100,200,500,1000] { for integ in [Integrator::Euler,Integrator::Propagator] {
        let mut best=f64::MAX; let mut s=(0.0,0.0); let mut s64=(0.0,0.0); let mut b64=f64::MAX;
        for _ in 0..(if us<50 {1} else {5}) { let t=std::time::Instant::now(); let g=run_stepped::<true>(&scene,&o2,&w2,us,integ); best=best.min(t.elapsed().as_secs_f64()*1e3); s=stats(&g,&e);
         let t=std::time::Instant::now(); let g=run_stepped::<false>(&scene,&o2,&w2,us,integ); b64=b64.min(t.elapsed().as_secs_f64()*1e3); s64=stats(&g,&e); }
        println!("{us} us {integ:?}: f32 {best:.2} ms rms {:.3} bias {:.4}; f64 {b64:.2} ms rms {:.3} bias {:.4}", s.0,s.1,s64.0,s64.1); } } }
    if let Ok(us)=std::env::var("US") { let us: u32=us.parse().unwrap(); let o2: Vec<u32>=(0..order.len() as u32).collect(); let w2: Vec<_>=order.iter().map(|&r| w[r as usize]).collect();
      for _ in 0..5 { let t=std::time::Instant::now(); for _ in 0..100 { meissner::simulate::run_stepped::<true>(&scene,&o2,&w2,us,meissner::simulate::Integrator::Propagator); } println!("{} us", t.elapsed().as_micros()/100); } return; }
    for _ in 0..50 { let t=std::time::Instant::now(); let g=run2(&scene,&order,&w); println!("{:?} spikes {}", t.elapsed(), g); }
}
fn stats(a:&[Vec<f64>],b:&[Vec<f64>])->(f64,f64){ let d: Vec<f64>=a.iter().zip(b).map(|(a,b)|a.len() as f64-b.len() as f64).collect(); ((d.iter().map(|x|x*x).sum::<f64>()/306.0).sqrt(), d.iter().sum::<f64>()/b.iter().map(|b|b.len() as f64).sum::<f64>()) }
fn run2(s:&Scene,o:&[u32],w:&[[f64;24]])->usize { let o2: Vec<u32>=(0..o.len() as u32).collect(); let w2: Vec<_>=o.iter().map(|&r| w[r as usize]).collect(); run(s,&o2,&w2).iter().map(Vec::len).sum() }
