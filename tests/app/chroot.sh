#!/bin/bash
# SPDX-License-Identifier: GPL-3.0-or-later
# usage: chroot.sh FOLDER
# Make a root folder with a Debian that has the real Blender, software OpenGL and a
# virtual display, for `make test-app CHROOT=FOLDER`: 1.3 GB. Needs the rights of root
# and debootstrap. MIRROR says where packages come from; else it is the system's own.
set -eu
folder=$1
mirror=${MIRROR:-$(
    { grep -hs '^URIs:' /etc/apt/sources.list.d/*.sources || true; \
      grep -hs '^deb ' /etc/apt/sources.list || true; } |
        awk '{print $2}' | grep -v security | head -1
)}
debootstrap --variant=minbase --include=ca-certificates sid "$folder" "$mirror"
# No services, no documentation, no waiting for the disk.
printf '#!/bin/sh\nexit 101\n' >"$folder/usr/sbin/policy-rc.d"
chmod +x "$folder/usr/sbin/policy-rc.d"
echo force-unsafe-io >"$folder/etc/dpkg/dpkg.cfg.d/speed"
printf 'path-exclude=/usr/share/doc/*\npath-exclude=/usr/share/man/*\n' \
    >"$folder/etc/dpkg/dpkg.cfg.d/nodoc"
cp /etc/resolv.conf "$folder/etc/resolv.conf"
chroot "$folder" env DEBIAN_FRONTEND=noninteractive apt-get install -y \
    --no-install-recommends blender python3-numpy python3-cattr python3-requests \
    xvfb xauth imagemagick xdotool libgl1-mesa-dri libglx-mesa0 libegl1 \
    libegl-mesa0 libgl1
chroot "$folder" apt-get clean
