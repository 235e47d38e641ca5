"""Messages of every kind, for hypothesis."""

from hypothesis import strategies as st

from imolo_drivers.natnet import messages as m
from imolo_drivers.natnet.wire import SUPPORTED, Version

real = st.floats(width=32, allow_nan=False)
vector = st.tuples(real, real, real)
quaternion = st.tuples(real, real, real, real)
int32 = st.integers(-(2**31), 2**31 - 1)
uint16 = st.integers(0, 2**16 - 1)
uint32 = st.integers(0, 2**32 - 1)
uint64 = st.integers(0, 2**64 - 1)
name = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=30)


def several(elements: st.SearchStrategy, most: int = 4) -> st.SearchStrategy:
    return st.lists(elements, max_size=most).map(tuple)


bodies = several(st.builds(m.RigidBody, int32, vector, quaternion, real, uint16))
markers = several(st.builds(m.LabelledMarker, uint16, uint16, vector, real, uint16, real))
analog = several(st.builds(m.AnalogChannels, int32, several(several(real))), 2)


def frames(version: Version) -> st.SearchStrategy[m.Frame]:
    return st.builds(
        m.Frame,
        number=int32,
        timestamp=st.floats(allow_nan=False),
        mid_exposure=uint64,
        markers=markers,
        marker_sets=several(st.builds(m.MarkerSet, name, several(vector)), 2),
        other_markers=several(vector),
        rigid_bodies=bodies,
        skeletons=several(st.builds(m.Skeleton, int32, bodies), 2),
        assets=several(st.builds(m.Asset, int32, bodies, markers), 2) if version >= (4, 1) else st.just(()),
        force_plates=analog,
        devices=analog,
        timecode=st.tuples(uint32, uint32),
        data_received=uint64,
        transmitted=uint64,
        precision_time=st.none() | st.tuples(uint32, uint32) if version >= (4, 0) else st.none(),
        flags=uint16,
    )


def definitions(version: Version) -> st.SearchStrategy[m.ModelDefinitions]:
    marker_name = name if version >= (4, 0) else st.just("")
    body = st.builds(
        m.RigidBodyDefinition,
        name,
        int32,
        int32,
        vector,
        several(st.builds(m.BodyMarkerDefinition, vector, int32, marker_name)),
    )
    kinds = [
        st.builds(m.MarkerSetDefinition, name, several(name)),
        body,
        st.builds(m.SkeletonDefinition, name, int32, several(body, 2)),
        st.builds(
            m.ForcePlateDefinition,
            int32,
            name,
            real,
            real,
            vector,
            st.lists(real, min_size=1, max_size=3).map(lambda some: tuple((some * 144)[:144])),
            st.lists(real, min_size=1, max_size=3).map(lambda some: tuple((some * 12)[:12])),
            int32,
            int32,
            several(name),
        ),
        st.builds(m.DeviceDefinition, int32, name, name, int32, int32, several(name)),
        st.builds(m.CameraDefinition, name, vector, quaternion),
    ]
    if version >= (4, 1):
        marker = st.builds(m.AssetMarkerDefinition, name, int32, vector, real, uint16)
        kinds.append(st.builds(m.AssetDefinition, name, int32, int32, several(body, 2), several(marker)))
    return st.builds(m.ModelDefinitions, several(st.one_of(kinds), 5))


byte = st.integers(0, 255)
others = st.one_of(
    st.builds(
        m.ServerInfo,
        name,
        st.tuples(byte, byte, byte, byte),
        st.sampled_from(SUPPORTED),
        st.integers(1, 2**64 - 1),
        uint16,
        st.none() | st.sampled_from(["239.255.42.99", "224.0.0.1"]),
    ),
    st.builds(m.Connect, name, st.tuples(byte, byte)),
    st.builds(m.Discovery, name, st.tuples(byte, byte)),
    st.builds(m.Request, name),
    st.builds(m.Response, st.binary(max_size=30)),
    st.builds(m.MessageString, name),
    st.builds(m.EchoRequest, uint64),
    st.builds(m.EchoResponse, uint64, uint64),
    st.sampled_from([m.ModelDefinitionsRequest(), m.Disconnect(), m.KeepAlive(), m.UnrecognizedRequest()]),
)


def any_message(version: Version) -> st.SearchStrategy[m.Message]:
    return st.one_of(frames(version), definitions(version), others)
