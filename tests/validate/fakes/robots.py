"""A robot of MuJoCo that has a bit of everything, and its time step [s]."""

H = 0.002
# A leg on a free trunk that falls on its foot, with a servo that has a state, a motor and three
# kinds of sensors.
LEG = f"""
<mujoco>
  <option timestep="{H}"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1"/>
    <body name="trunk" pos="0 0 .55">
      <freejoint name="root"/>
      <geom name="hull" type="box" size=".1 .1 .05" mass="2"/>
      <site name="imu"/>
      <body name="thigh" pos="0 0 -.1">
        <joint name="hip" axis="0 1 0" damping=".1"/>
        <geom type="capsule" fromto="0 0 0 0 0 -.2" size=".03"/>
        <body name="shank" pos="0 0 -.2">
          <joint name="knee" axis="0 1 0" range="-90 90" damping=".1"/>
          <geom name="foot" type="capsule" fromto="0 0 0 0 0 -.15" size=".02"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="hip" joint="hip" ctrlrange="-8 8"/>
    <general name="knee" joint="knee" dyntype="filter" dynprm=".05" gainprm="20" biastype="affine" biasprm="0 -20 0"/>
  </actuator>
  <sensor>
    <jointpos name="hip angle" joint="hip"/>
    <accelerometer name="imu" site="imu"/>
    <touch name="trunk" site="imu"/>
  </sensor>
  <keyframe><key name="bent" qpos="0 0 .5 1 0 0 0 .4 -.8" ctrl="1 -.8" act="-.8"/></keyframe>
</mujoco>
"""
