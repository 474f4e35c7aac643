# shellcheck shell=bash
# Makes a minimal Debian system that QEMU or a container boots. Sourced by verify/usb/run, verify/install/run and
# verify/realtime/run, which set `-Eeuo pipefail` and `name` first.

suite=trixie
keyring=/usr/share/keyrings/debian-archive-keyring.gpg

die() {
    # shellcheck disable=SC2154 # set by the script that sources this
    printf '%s: %s\n' "$name" "$*" >&2
    exit 1
}
say() { printf -- '-- %s\n' "$*"; }
as_root() {
    if [ "$(id -u)" = 0 ]; then
        "$@"
    elif command -v sudo >/dev/null; then
        sudo "$@"
    else
        die "installing and making the guest need root or sudo: $1"
    fi
}

# need PACKAGE FILE-OR-COMMAND: installs the package if the file or command is missing
need() {
    if command -v "$2" >/dev/null || [[ $2 == /* && -e $2 ]]; then return 0; fi
    command -v apt-get >/dev/null || die "no $2 and no apt: install it"
    say "installing $1"
    local install=(env DEBIAN_FRONTEND=noninteractive apt-get install -qq --no-install-recommends "$1")
    as_root "${install[@]}" >/dev/null 2>&1 || {
        as_root apt-get update -qq >/dev/null
        as_root "${install[@]}" >/dev/null
    } || die "apt cannot install $1"
}

# debian TREE LOG PACKAGE...: makes a minimal Debian system with systemd and these packages
debian() {
    local tree=$1 log=$2 mirror more
    need debootstrap debootstrap
    need debian-archive-keyring $keyring
    # shellcheck disable=SC2016 # apt's variables
    mirror=${DEBIAN_MIRROR:-$(apt-get indextargets --format '$(REPO_URI)' \
        'Created-By: Packages' 'Label: Debian' 'Component: main' | head -n 1)}
    [ -n "$mirror" ] || die "apt knows no Debian mirror: run apt-get update, or set DEBIAN_MIRROR"
    as_root rm -rf "$tree"
    mkdir -p "$(dirname "$tree")"
    say "making the guest (some minutes, once)"
    more=$(printf ',%s' "${@:3}")
    as_root debootstrap --variant=minbase --keyring=$keyring --include="systemd,systemd-sysv,udev,jq$more" \
        $suite "$tree" "$mirror" >"$log" 2>&1 || die "debootstrap failed: see $log"
}

# slim TREE: removes files that no test reads
slim() {
    as_root sh -c "cd '$1' && rm -rf tmp/* var/cache/apt/* var/lib/apt/lists/* usr/share/doc usr/share/man \
        usr/share/locale usr/share/info"
}

# kernel TREE VMLINUZ LOG MODULE...: Debian's stock kernel, with only these modules and those they need
kernel() {
    local tree=$1 log=$3 package version needed module
    package=$(as_root chroot "$tree" apt-cache depends linux-image-amd64 | sed -n 's/.*Depends: \(linux-image-.*\)/\1/p')
    [ -n "$package" ] || die "$suite has no linux-image-amd64"
    as_root chroot "$tree" sh -c "cd /tmp && apt-get -o APT::Sandbox::User=root download $package" \
        >"$log" 2>&1 || die "no kernel: see $log"
    as_root sh -c "dpkg -x '$tree'/tmp/linux-image-*.deb '$tree/tmp/kernel'"
    version=$(ls "$tree/tmp/kernel/usr/lib/modules")
    cp "$tree/tmp/kernel/boot/vmlinuz-$version" "$2"
    as_root mkdir -p "$tree/usr/lib/modules"
    as_root mv "$tree/tmp/kernel/usr/lib/modules/$version" "$tree/tmp/modules"
    as_root cp -a "$tree/tmp/modules" "$tree/usr/lib/modules/$version"
    as_root chroot "$tree" depmod "$version"
    needed=$(as_root chroot "$tree" modprobe -S "$version" --show-depends -a "${@:4}" | sed -n 's/^insmod //p')
    # Only those in use: the whole tree lives in memory.
    as_root rm -rf "$tree/usr/lib/modules/$version/kernel"
    for module in $needed; do
        as_root install -D -m 644 "$tree/tmp/modules/${module#*/"$version"/}" "$tree/usr/$module"
    done
    as_root chroot "$tree" depmod "$version"
}

# pack TREE CPIO: packs a tree for QEMU and removes it
pack() {
    as_root ln -sf usr/lib/systemd/systemd "$1/init"
    (cd "$1" && as_root find . -xdev -print0 | as_root cpio --null --quiet -o -H newc) >"$2.new"
    as_root rm -rf "$1"
    mv "$2.new" "$2"
}

# program FROM TO: copies a program without debug information, which takes a quarter of the memory
program() { strip -o "$2" "$1" 2>/dev/null || cp "$1" "$2"; }

# package PROFILE FILE: builds the Debian package from the sources in this directory
package() {
    # A tested version of cargo-deb, built without optimisation, because in a fresh clone building it takes longer than using it.
    # It packs with xz.
    local version=3.8.0 tools=$PWD/target/tools said=$2.log quiet=()
    if [ "$("$tools/bin/cargo-deb" --version 2>/dev/null)" != "cargo-deb $version" ]; then
        say "building cargo-deb (some minutes, once)"
        cargo install cargo-deb --version $version --locked --quiet --debug --no-default-features --force \
            --config profile.dev.debug=0 --root "$tools" --target-dir "$tools/build" || die "cargo-deb does not build"
        rm -rf "$tools/build"
    fi
    need xz-utils xz
    need dpkg-dev dpkg-shlibdeps
    say "building the package"
    cargo build --profile "$1" --locked --quiet || die "meissner does not build"
    rm -rf target/manual
    cargo run --profile "$1" --locked --quiet -- manual target/manual || die "meissner does not write its manual"
    # It warns that a package of profile `dev` should not be released. This one is not.
    [ "$1" != dev ] || quiet=(--quiet)
    "$tools/bin/cargo-deb" --no-build "${quiet[@]}" --strip --no-dbgsym --profile "$1" -o "$2" >/dev/null 2>"$said" ||
        die "cargo deb: $(<"$said")"
    # All other warnings are errors.
    [ ! -s "$said" ] || die "cargo deb: $(<"$said")"
}

# boot LIMIT_S VMLINUZ INITRD UNIT [QEMU-OPTION...]: prints the console's text without escape sequences
boot() {
    timeout --foreground "$1" qemu-system-x86_64 -accel tcg,thread=multi -cpu max -m 1500 -smp 2 -nic none \
        -nographic -no-reboot -kernel "$2" -initrd "$3" "${@:5}" \
        -append "console=ttyS0 quiet loglevel=3 systemd.show_status=false systemd.unit=$4 panic=-1" </dev/null 2>&1 |
        sed -u 's/\r//g; s/\x1b\][^\x1b\a]*\(\x1b\\\|\a\)//g; s/\x1b[c7]//g; s/\x1b\[[0-9;?!]*[A-Za-z]//g'
}

# judge LOG STEP...: fails unless the console's log has an ok line for every step
judge() {
    local log=$1 seen step
    seen=$(grep -E "^(FAIL|WRONG)" "$log" | tr -s " " | paste -sd\;) || true
    [ -z "$seen" ] || die "$seen (all of it in $log)"
    for step in "${@:2}"; do
        grep -Eq "^ok +${step//./ +}:" "$log" || die "${step//./ } was not seen; see $log"
    done
}
