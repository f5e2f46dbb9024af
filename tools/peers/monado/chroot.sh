#!/bin/sh
# Make a Debian trixie root with Monado, software OpenGL and this checkout's Python packages.
#
#     sudo sh tools/peers/monado/chroot.sh /var/tmp/glsplat-monado      # 2 GB, five minutes; may be run again
#     sudo env GLSPLAT_MONADO_ROOT=/var/tmp/glsplat-monado pytest tools/peers/monado/test_monado.py
#
# Needs root, debootstrap, and a mirror of Debian and of PyPI as this machine has them. What it mounts goes with
# `umount`: see the end.
set -eu
root=${1:?usage: chroot.sh FOLDER}
here=$(cd "$(dirname "$0")/../../.." && pwd)
[ -e "$root/usr/bin/python3" ] || debootstrap --variant=minbase --include=ca-certificates,python3,python3-venv trixie "$root"
for file in /etc/resolv.conf /etc/hosts /etc/ssl/certs/ca-certificates.crt /etc/pip.conf; do
    [ ! -e "$file" ] || cp -L "$file" "$root$file"
done
cp /etc/apt/apt.conf.d/99* "$root/etc/apt/apt.conf.d/" 2>/dev/null || true
mountpoint -q "$root/proc" || mount -t proc proc "$root/proc"
mountpoint -q "$root/dev" || { mount --rbind /dev "$root/dev" && mount --make-rslave "$root/dev"; }
mkdir -p "$root/src"
mountpoint -q "$root/src" || { mount --bind "$here" "$root/src" && mount -o remount,bind,ro "$root/src"; }
chroot "$root" apt-get -q update
DEBIAN_FRONTEND=noninteractive chroot "$root" apt-get -q install -y --no-install-recommends \
    monado-service libopenxr1-monado libopenxr-loader1 openxr-layer-corevalidation \
    libegl1 libgl1 libegl-mesa0 libgl1-mesa-dri libglx-mesa0 mesa-vulkan-drivers libglfw3 xvfb
[ -x "$root/venv/bin/python" ] || chroot "$root" python3 -m venv /venv
chroot "$root" /venv/bin/python - > "$root/tmp/needs.txt" <<'PY'
import tomllib
project = tomllib.load(open("/src/pyproject.toml", "rb"))["project"]
print("\n".join([*project["dependencies"], *project["optional-dependencies"]["openxr"]]))
PY
chroot "$root" /venv/bin/pip -q install -r /tmp/needs.txt
echo "ready: $root"
echo "to remove it: umount -l $root/src $root/dev $root/proc && rm -r $root"
