#version 330 core
// pyrender defines the locations. Every primitive has texture coordinates, colours and a texture.
layout(location = 0) in vec3 position;
layout(location = NORMAL_LOC) in vec3 normal;
layout(location = TEXCOORD_0_LOC) in vec2 texcoord_0;
layout(location = COLOR_0_LOC) in vec4 color_0;
layout(location = INST_M_LOC) in mat4 inst_m;
uniform mat4 M, V, P;
out vec2 uv_0;
out vec3 point, face_normal, colour;
void main() {
    point = vec3(M * inst_m * vec4(position, 1.0));
    gl_Position = P * V * vec4(point, 1.0);
    face_normal = normal;
    uv_0 = texcoord_0;
    colour = color_0.rgb;
}
