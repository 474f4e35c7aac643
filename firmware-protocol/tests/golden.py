"""Makes the golden bytes of version 7 without the program's encoder: COBS, CRC-32 and varints by hand."""
import binascii,struct
V=7
def u(n):
    out=b''
    while n>=0x80: out+=bytes([n&0x7f|0x80]); n>>=7
    return out+bytes([n])
def z(n): return u((n<<1)^(n>>63) if n>=0 else ((-n)<<1)-1)
def opt(x): return b'\0' if x is None else b'\1'+x
def cobs(data):
    out=bytearray(); block=bytearray()
    for b in data+b'\0':
        if b==0: out.append(len(block)+1); out+=block; block=bytearray()
        else:
            block.append(b); assert len(block)<254 or True
    return bytes(out)
def frame(body):
    m=bytes([V])+body
    m+=struct.pack('<I',binascii.crc32(m))
    assert len(m)<=254
    return (cobs(m)+b'\0').hex()
BASE=0xfeedf00d
wire=lambda t: struct.pack('<I',t&0xffffffff)
base=wire(BASE); rendered=wire(BASE+64)
def level(n,surplus): return u(n<<1|(surplus>0))+(u(surplus) if surplus else b'')
def batch(items,base):
    """Each item: 'move', motor, tick, level, surplus; 'stroke', motor, up, level, ticks held, surplus; 'row', tick, {motor: level}."""
    out=b''; at=base; stroke=None; motors=0
    for kind,*item in items:
        if kind=='move':
            motor,tick,n,surplus=item
            out+=bytes([motor])+u(tick-at)+level(n,surplus)
        elif kind=='stroke':
            motor,tick,n,held,surplus=item
            if stroke==(n,surplus): out+=bytes([0x80|motor])+u(tick-at)+u(held)
            else: out+=bytes([0x40|motor])+u(tick-at)+level(n,surplus)+u(held)
            stroke=(n,surplus)
        else:
            tick,levels=item
            mask=sum(1<<motor for motor in levels)
            out+=b'\xc0'+u(tick-at) if mask==motors else b'\xc1'+u(tick-at)+u(mask)
            for motor in sorted(levels): out+=u(levels[motor])
            motors=mask
        at=tick
    return out
def amends(items,base):
    out=b''; at=base
    for motor,tick,pulses in items:
        out+=bytes([motor])+z(tick-at)+u(pulses); at=tick
    return out
lim=u(20000)+u(90000)+bytes([3,1])
def arm(stop): return b'\0'+b'\1'+u(25500)+lim+opt(None if stop is None else u(stop[0])+u(stop[1]))
def control(op): return b'\2'+u(7)+u(400)+op
def st(epoch,seq,seen,mark,withdraw,batch): return b'\3'+u(epoch)+u(seq)+u(seen)+opt(mark)+opt(withdraw)+base+u(len(batch))+batch
trig=lambda w,c: u(w)+bytes([c])
def mark(kind,trigger,hold): return bytes([kind])+opt(trigger)+u(hold)
onset=mark(0,trig(850,0),5100000)
S=batch([('stroke',0,BASE,147,561,0),('stroke',23,BASE+59,147,561,0),('stroke',23,BASE+1600,147,561,3),('stroke',63,BASE+100000,3000,0,0)],BASE)
M=batch([('move',0,BASE,1,0),('move',23,BASE,64,0),('move',0,BASE+85,3000,0),('move',63,BASE+200000,0,900)],BASE)
R=batch([('row',BASE+170,{0:0,23:300,63:3000}),('row',BASE+340,{0:127,23:128,63:0}),('stroke',1,BASE+341,147,0,0),
 ('row',BASE+510,{0:1}),('move',0,BASE+600,0,1),('stroke',2,BASE+600,147,0,0),('row',BASE+680,{0:2}),('row',BASE+850,{n:n for n in range(24)})],BASE)
A=amends([(9,BASE+1417,151),(63,BASE+1400,143)],BASE)
host=[b'\0'+u(0xdeadbeef),b'\1'+u(513)+u(0),control(arm(None)),control(arm((17000,7400))),control(b'\6'+u(7400)),
 control(b'\1'+b'\3'),control(b'\1'+b'\4'),control(b'\2'),control(b'\3'),control(b'\4'),control(b'\5'+bytes([5])+b'\1'+u(1000)),
 st(7,0,1,onset,None,S),st(7,0,1,None,None,M),st(7,0,1,None,None,R),st(7,1,1,mark(1,trig(85,200),0),None,b''),st(7,1,1,mark(0,None,17000),None,b''),
 st(7,2,1,None,u(1<<63|0x00800001)+u(300),b''),st(7,65535,1,None,None,b''),
 b'\4'+u(7)+u(1000)+base+u(len(A))+A,b'\5'+u(300),b'\6'+u(65535)]
print("HOST")
for h in host: print(frame(h))
COUNT=b''.join(u(n) for n in (1,294,3,4,5,10,6,11,7,8,9))
def cut(cause=6,ret=1200): return bytes([cause,1,2,3,4])+opt(None if ret is None else u(ret))+u(300)+u(77)
def array(name=b'tula35-6x4',motors=24,hz=85000,du=200,dd=800,h=0x0123456789abcdef): return u(len(name))+name+bytes([motors])+u(hz)+u(du)+u(dd)+u(h)
NONE=u(85000)+u(510000)+bytes([6,2])
def hello(c): return b'\0'+u(0xdeadbeef)+bytes([1,2,3])+bytes([0xca,0xfe,0,1])+u(99)+array()+u(1024)+bytes([107])+u(3000)+NONE+u(3)+u(0xffd91a30)+u(1)+u(0)+opt(c)
def status(state,cause,refusal): return b'\2'+u(513)+bytes([0xff,0,0xfe,0x7f])+u(2)+opt(refusal)+u(300)+bytes([5])+u(1024)+u(5)+bytes([state,cause,1])+u(0)+COUNT
def report(r): return b'\3'+u(200)+r
def refused(n): return report(b'\4'+bytes([17])+base+bytes([n]))
def telemetry(first,y): return b'\4'+rendered+bytes([first])+u(len(y))+b''.join(z(v) for v in y)
def outs(l,t=0,e=0): return u(l)+bytes([t,e])
def board(reset=4,a=26,b=25,c=1,d=2,h=outs(1<<23,0,1)):
    o=lambda x: opt(None if x is None else bytes([x]))
    return b'\5'+u(300)+bytes([reset])+u(86400)+o(a)+o(b)+o(c)+o(d)+u(3)+opt(h)
def test(s): return b'\6'+u(300)+s
y=[0]*24; y[0],y[1],y[22],y[23]=1,-1,8000,-2**31
lines=outs(1)+outs(2)+outs(12,1,1)+opt(bytes([0,2])+bytes([1]))
done=opt(lines)+opt(u(100000)+u(8500)+u(34000))+opt(u(65536)+opt(u(0x20030000)))+opt(u(158))
dev=[hello(cut()),hello(None),b'\1',status(1,1,None),status(0,0,b'\x08'),status(2,7,b'\x09'),status(2,8,b'\x0a'),status(3,5,None),status(3,9,None),status(3,12,None),status(3,10,b'\x0b'),
 report(b'\0'+u(300)+u(1)+u(1<<63)+u(1<<63|0x00800001)+opt(b'\0')+rendered),
 report(b'\1'+u(1)+rendered),report(b'\2'+rendered+COUNT),report(b'\3'+cut()),report(b'\3'+cut(2,None))]
dev+=[report(b'\5'+rendered+u(1<<63|0x00800001)+u(6)),report(b'\6'+rendered+u(300))]
dev+=[refused(n) for n in (1,2,3,4,5,6,7,12,13,14,15)]
dev+=[telemetry(0,y),telemetry(32,[-5]*32),board(),board(6,None,None,None,None,None),test(b'\0'),test(b'\1'),test(b'\2'),test(b'\3'+done),test(b'\3'+b'\0'*4)]
print("DEVICE")
for d in dev: print(frame(d))
